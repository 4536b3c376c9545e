from .biexponential import BiexponentialFit, biexponential_fit
from .bond_order import (
    block_susceptibilities,
    global_psi6,
    hexatic_susceptibility,
    local_psi6,
    psi6,
    psi6_series,
    susceptibility_of_run,
)
from .correlation import (
    Correlation,
    ValueCorrelation,
    order_correlation_of_run,
    pearson_correlation,
    value_correlation,
)
from .defect_clusters import Defects, found_defects
from .defect_motion import defects_of_frames, tracked_defects
from .defect_tracks import (
    DefectEvent,
    DefectMotion,
    DefectTrack,
    found_events,
    lasting_tracks,
    linked_tracks,
    motion_of_track,
)
from .defects import Dislocations, defect_series, disclination_charges, dislocations
from .displacement import (
    displacement_of_run,
    lindemann_of_run,
    lindemann_parameter,
    mean_square_displacement,
    non_gaussian_of_run,
    non_gaussian_parameter,
)
from .distance import (
    least_piston_distance,
    mean_pair_distance,
    pair_distance_series,
    piston_distance_series,
    source_pair_distance,
)
from .fluctuation import fluctuation_series, relative_fluctuation
from .force_distribution import (
    DipTest,
    Histogram,
    dip_test,
    force_distribution_of_run,
    force_modes_of_run,
    knuth_bins,
    knuth_histogram,
)
from .forces import (
    compressive_force_series,
    compressive_forces,
    force_magnitudes,
    grain_forces,
    interaction_forces,
    piston_force,
    wall_forces,
)
from .grain_stress import grain_pressures, grain_stress_series, grain_stresses, grain_virials
from .hysteresis import Cycle, cycle_bounds, hysteresis_energy, hysteresis_of_run
from .interactions import Interactions, pair_interactions, wall_interactions
from .moduli import (
    BedModuli,
    Moduli,
    bed_moduli,
    crystal_moduli,
    dipole_strength,
    hexagonal_sum,
    interaction_parameter,
    lattice_spacing,
    theory_modulus,
)
from .named import OBSERVABLES, observable_named
from .non_affine import NonAffineMotion, non_affine_motion, non_affine_series
from .of_frames import Frame, Observable, observable, with_observables
from .orientation import (
    BondCorrelation,
    Directions,
    bond_correlation,
    bond_correlation_of_run,
    bond_relaxation,
    bond_relaxation_of_run,
    direction_order,
)
from .packing import area_fraction_profile, area_profile_series, packing_fraction, packing_series
from .plasticity import (
    DropStatistics,
    PlasticEvents,
    drop_statistics,
    plastic_events,
    plastic_events_of_run,
)
from .radial import RadialDistribution, radial_distribution, radial_distribution_of_run
from .response import FrequencyResponse, frequency_response, response_of_run
from .slip import Slip, elastic_strain, slip_of_frames
from .temperature import (
    configurational_temperature,
    configurational_temperature_of_run,
    kinetic_temperature,
    temperature_series,
)
from .translation import (
    TranslationalCorrelation,
    lattice_vector,
    structure_factor,
    translational_correlation,
    translational_correlation_of_run,
    translational_order,
)
from .voronoi import (
    CellShares,
    VoronoiCells,
    cell_polygons,
    cell_shares,
    hexagon_regularity,
    regularity_series,
    share_series,
    voronoi_cells,
)

__all__ = [
    "OBSERVABLES", "BedModuli", "BiexponentialFit", "BondCorrelation", "CellShares",
    "Correlation", "Cycle", "DefectEvent", "DefectMotion", "DefectTrack", "Defects", "DipTest",
    "Directions", "Dislocations", "DropStatistics", "Frame", "FrequencyResponse", "Histogram",
    "Interactions", "Moduli", "NonAffineMotion", "Observable", "PlasticEvents",
    "RadialDistribution", "Slip", "TranslationalCorrelation", "ValueCorrelation",
    "VoronoiCells", "area_fraction_profile", "area_profile_series", "bed_moduli",
    "biexponential_fit", "block_susceptibilities", "bond_correlation",
    "bond_correlation_of_run", "bond_relaxation", "bond_relaxation_of_run", "cell_polygons",
    "cell_shares", "compressive_force_series", "compressive_forces",
    "configurational_temperature", "configurational_temperature_of_run", "crystal_moduli",
    "cycle_bounds", "defect_series", "defects_of_frames", "dip_test", "dipole_strength",
    "direction_order", "disclination_charges", "dislocations", "displacement_of_run",
    "drop_statistics", "elastic_strain", "fluctuation_series", "force_distribution_of_run",
    "force_magnitudes", "force_modes_of_run", "found_defects", "found_events",
    "frequency_response", "global_psi6", "grain_forces", "grain_pressures",
    "grain_stress_series", "grain_stresses", "grain_virials", "hexagon_regularity",
    "hexagonal_sum", "hexatic_susceptibility", "hysteresis_energy", "hysteresis_of_run",
    "interaction_forces", "interaction_parameter", "kinetic_temperature", "knuth_bins",
    "knuth_histogram", "lasting_tracks", "lattice_spacing", "lattice_vector",
    "least_piston_distance", "lindemann_of_run", "lindemann_parameter", "linked_tracks",
    "local_psi6", "mean_pair_distance", "mean_square_displacement", "motion_of_track",
    "non_affine_motion", "non_affine_series", "non_gaussian_of_run", "non_gaussian_parameter",
    "observable", "observable_named", "order_correlation_of_run", "packing_fraction",
    "packing_series", "pair_distance_series", "pair_interactions", "pearson_correlation",
    "piston_distance_series", "piston_force", "plastic_events", "plastic_events_of_run", "psi6",
    "psi6_series", "radial_distribution", "radial_distribution_of_run", "regularity_series",
    "relative_fluctuation", "response_of_run", "share_series", "slip_of_frames",
    "source_pair_distance", "structure_factor", "susceptibility_of_run", "temperature_series",
    "theory_modulus", "tracked_defects", "translational_correlation",
    "translational_correlation_of_run", "translational_order", "value_correlation",
    "voronoi_cells", "wall_forces", "wall_interactions", "with_observables",
]  # fmt: skip
