from .area_profile import (
    area_fraction_profile as area_fraction_profile,
)
from .area_profile import (
    area_profile_series as area_profile_series,
)
from .biexponential import (
    BiexponentialFit as BiexponentialFit,
)
from .biexponential import (
    biexponential_fit as biexponential_fit,
)
from .bond_order import (
    global_psi6 as global_psi6,
)
from .bond_order import (
    local_psi6 as local_psi6,
)
from .bond_order import (
    psi6 as psi6,
)
from .bond_order import (
    psi6_series as psi6_series,
)
from .compression import (
    compressive_force_series as compressive_force_series,
)
from .compression import (
    compressive_forces as compressive_forces,
)
from .configurational import (
    configurational_temperature as configurational_temperature,
)
from .configurational import (
    configurational_temperature_of_run as configurational_temperature_of_run,
)
from .correlation import (
    Correlation as Correlation,
)
from .correlation import (
    order_correlation_of_run as order_correlation_of_run,
)
from .correlation import (
    pearson_correlation as pearson_correlation,
)
from .defect_clusters import (
    Defects as Defects,
)
from .defect_clusters import (
    found_defects as found_defects,
)
from .defect_motion import (
    defects_of_frames as defects_of_frames,
)
from .defect_motion import (
    tracked_defects as tracked_defects,
)
from .defect_tracks import (
    DefectEvent as DefectEvent,
)
from .defect_tracks import (
    DefectMotion as DefectMotion,
)
from .defect_tracks import (
    DefectTrack as DefectTrack,
)
from .defect_tracks import (
    found_events as found_events,
)
from .defect_tracks import (
    lasting_tracks as lasting_tracks,
)
from .defect_tracks import (
    linked_tracks as linked_tracks,
)
from .defect_tracks import (
    motion_of_track as motion_of_track,
)
from .defects import (
    Dislocations as Dislocations,
)
from .defects import (
    defect_series as defect_series,
)
from .defects import (
    disclination_charges as disclination_charges,
)
from .defects import (
    dislocations as dislocations,
)
from .dip import (
    DipTest as DipTest,
)
from .dip import (
    dip_test as dip_test,
)
from .directions import (
    Directions as Directions,
)
from .directions import (
    direction_order as direction_order,
)
from .distance import (
    mean_pair_distance as mean_pair_distance,
)
from .distance import (
    pair_distance_series as pair_distance_series,
)
from .distance import (
    source_pair_distance as source_pair_distance,
)
from .elasticity import (
    BedModuli as BedModuli,
)
from .elasticity import (
    bed_moduli as bed_moduli,
)
from .fluctuation import (
    fluctuation_series as fluctuation_series,
)
from .fluctuation import (
    relative_fluctuation as relative_fluctuation,
)
from .force_distribution import (
    Histogram as Histogram,
)
from .force_distribution import (
    force_distribution_of_run as force_distribution_of_run,
)
from .force_distribution import (
    force_modes_of_run as force_modes_of_run,
)
from .force_distribution import (
    knuth_bins as knuth_bins,
)
from .force_distribution import (
    knuth_histogram as knuth_histogram,
)
from .forces import (
    force_magnitudes as force_magnitudes,
)
from .forces import (
    grain_forces as grain_forces,
)
from .forces import (
    interaction_forces as interaction_forces,
)
from .forces import (
    piston_force as piston_force,
)
from .forces import (
    wall_forces as wall_forces,
)
from .grain_correlation import (
    ValueCorrelation as ValueCorrelation,
)
from .grain_correlation import (
    value_correlation as value_correlation,
)
from .grain_stress import (
    grain_pressures as grain_pressures,
)
from .grain_stress import (
    grain_stress_series as grain_stress_series,
)
from .grain_stress import (
    grain_stresses as grain_stresses,
)
from .grain_stress import (
    grain_virials as grain_virials,
)
from .hexatic import (
    block_susceptibilities as block_susceptibilities,
)
from .hexatic import (
    hexatic_susceptibility as hexatic_susceptibility,
)
from .hexatic import (
    susceptibility_of_run as susceptibility_of_run,
)
from .hysteresis import (
    Cycle as Cycle,
)
from .hysteresis import (
    cycle_bounds as cycle_bounds,
)
from .hysteresis import (
    hysteresis_energy as hysteresis_energy,
)
from .hysteresis import (
    hysteresis_of_run as hysteresis_of_run,
)
from .interactions import (
    Interactions as Interactions,
)
from .interactions import (
    pair_interactions as pair_interactions,
)
from .interactions import (
    wall_interactions as wall_interactions,
)
from .lindemann import (
    lindemann_of_run as lindemann_of_run,
)
from .lindemann import (
    lindemann_parameter as lindemann_parameter,
)
from .moduli import (
    Moduli as Moduli,
)
from .moduli import (
    crystal_moduli as crystal_moduli,
)
from .moduli import (
    dipole_strength as dipole_strength,
)
from .moduli import (
    hexagonal_sum as hexagonal_sum,
)
from .moduli import (
    interaction_parameter as interaction_parameter,
)
from .moduli import (
    lattice_spacing as lattice_spacing,
)
from .moduli import (
    theory_modulus as theory_modulus,
)
from .named import (
    OBSERVABLES as OBSERVABLES,
)
from .named import (
    observable_named as observable_named,
)
from .non_affine import (
    NonAffineMotion as NonAffineMotion,
)
from .non_affine import (
    non_affine_motion as non_affine_motion,
)
from .non_affine import (
    non_affine_series as non_affine_series,
)
from .non_gaussian import (
    displacement_of_run as displacement_of_run,
)
from .non_gaussian import (
    mean_square_displacement as mean_square_displacement,
)
from .non_gaussian import (
    non_gaussian_of_run as non_gaussian_of_run,
)
from .non_gaussian import (
    non_gaussian_parameter as non_gaussian_parameter,
)
from .of_frames import (
    Frame as Frame,
)
from .of_frames import (
    Observable as Observable,
)
from .of_frames import (
    observable as observable,
)
from .of_frames import (
    with_observables as with_observables,
)
from .orientation import (
    BondCorrelation as BondCorrelation,
)
from .orientation import (
    bond_correlation as bond_correlation,
)
from .orientation import (
    bond_correlation_of_run as bond_correlation_of_run,
)
from .packing import (
    packing_fraction as packing_fraction,
)
from .packing import (
    packing_series as packing_series,
)
from .piston_distance import (
    least_piston_distance as least_piston_distance,
)
from .piston_distance import (
    piston_distance_series as piston_distance_series,
)
from .plasticity import (
    DropStatistics as DropStatistics,
)
from .plasticity import (
    PlasticEvents as PlasticEvents,
)
from .plasticity import (
    drop_statistics as drop_statistics,
)
from .plasticity import (
    plastic_events as plastic_events,
)
from .plasticity import (
    plastic_events_of_run as plastic_events_of_run,
)
from .radial import (
    RadialDistribution as RadialDistribution,
)
from .radial import (
    radial_distribution as radial_distribution,
)
from .radial import (
    radial_distribution_of_run as radial_distribution_of_run,
)
from .regularity import (
    hexagon_regularity as hexagon_regularity,
)
from .regularity import (
    regularity_series as regularity_series,
)
from .relaxation import (
    bond_relaxation as bond_relaxation,
)
from .relaxation import (
    bond_relaxation_of_run as bond_relaxation_of_run,
)
from .response import (
    FrequencyResponse as FrequencyResponse,
)
from .response import (
    frequency_response as frequency_response,
)
from .response import (
    response_of_run as response_of_run,
)
from .slip import (
    Slip as Slip,
)
from .slip import (
    elastic_strain as elastic_strain,
)
from .slip import (
    slip_of_frames as slip_of_frames,
)
from .structure import (
    lattice_vector as lattice_vector,
)
from .structure import (
    structure_factor as structure_factor,
)
from .temperature import (
    kinetic_temperature as kinetic_temperature,
)
from .temperature import (
    temperature_series as temperature_series,
)
from .translation import (
    TranslationalCorrelation as TranslationalCorrelation,
)
from .translation import (
    translational_correlation as translational_correlation,
)
from .translation import (
    translational_correlation_of_run as translational_correlation_of_run,
)
from .translation import (
    translational_order as translational_order,
)
from .voronoi import (
    CellShares as CellShares,
)
from .voronoi import (
    VoronoiCells as VoronoiCells,
)
from .voronoi import (
    cell_polygons as cell_polygons,
)
from .voronoi import (
    cell_shares as cell_shares,
)
from .voronoi import (
    share_series as share_series,
)
from .voronoi import (
    voronoi_cells as voronoi_cells,
)
