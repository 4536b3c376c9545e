from .biexponential import biexponential_fit
from .bond_order import bond_correlation, bond_relaxation, global_psi6, local_psi6, psi6
from .catalogue import OBSERVABLES, per_frame
from .correlation import per_distance, radial_distribution, spatial_correlation
from .defect_clusters import detect_defects
from .defect_tracks import track_defects
from .defects import disclination_charges, dislocations
from .displacement import (
    lindemann_parameter,
    mean_square_displacement,
    non_affine_motion,
    non_affine_series,
    per_lag,
)
from .forces import (
    compressive_forces,
    force_dip_test,
    force_distribution,
    grain_pressures,
    grain_stresses,
    grain_virials,
    interaction_forces,
    relative_force_fluctuation,
    wall_forces,
)
from .frame import Frame, frame_at, observable
from .harmonics import harmonic_response, stage_response
from .hysteresis import hysteresis_cycles, hysteresis_energy
from .moduli import (
    bed_moduli,
    crystal_moduli,
    dipole_pair_strength,
    interaction_parameter,
    melting_theory_modulus,
)
from .packing import (
    area_fraction_by_depth,
    area_fraction_profile,
    depaula_pair_distance,
    least_piston_distance,
    mean_pair_distance,
    packing_fraction,
    packing_fraction_series,
)
from .plasticity import drop_statistics, elastic_strain, plastic_distortion, plastic_events
from .statistics import axial_order_parameter, dip_test, knuth_histogram, pearson_correlation
from .temperature import configurational_temperature, kinetic_temperature
from .voronoi import cell_polygons, hexagon_regularity, polygon_fractions, voronoi_cells

__all__ = [
    "OBSERVABLES",
    "Frame",
    "area_fraction_by_depth",
    "area_fraction_profile",
    "axial_order_parameter",
    "bed_moduli",
    "biexponential_fit",
    "bond_correlation",
    "bond_relaxation",
    "cell_polygons",
    "compressive_forces",
    "configurational_temperature",
    "crystal_moduli",
    "depaula_pair_distance",
    "detect_defects",
    "dip_test",
    "dipole_pair_strength",
    "disclination_charges",
    "dislocations",
    "drop_statistics",
    "elastic_strain",
    "force_dip_test",
    "force_distribution",
    "frame_at",
    "global_psi6",
    "grain_pressures",
    "grain_stresses",
    "grain_virials",
    "harmonic_response",
    "hexagon_regularity",
    "hysteresis_cycles",
    "hysteresis_energy",
    "interaction_forces",
    "interaction_parameter",
    "kinetic_temperature",
    "knuth_histogram",
    "least_piston_distance",
    "lindemann_parameter",
    "local_psi6",
    "mean_pair_distance",
    "mean_square_displacement",
    "melting_theory_modulus",
    "non_affine_motion",
    "non_affine_series",
    "observable",
    "packing_fraction",
    "packing_fraction_series",
    "pearson_correlation",
    "per_distance",
    "per_frame",
    "per_lag",
    "plastic_distortion",
    "plastic_events",
    "polygon_fractions",
    "psi6",
    "radial_distribution",
    "relative_force_fluctuation",
    "spatial_correlation",
    "stage_response",
    "track_defects",
    "voronoi_cells",
    "wall_forces",
]
