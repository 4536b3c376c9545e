from .calibration.calibrate import calibrate
from .derived.derive import derive
from .designs.damper import DamperCandidate
from .designs.design import design, propose_design
from .designs.result import DesignTarget
from .discovery.discover import DiscoveryOptions, discover
from .falls.predicted_law import predict, valid_shaking_range
from .falls.unseen_fall_scores import score_drops, whole_fall
from .fitting.fit import fit
from .fitting.law_estimator import LawEstimator
from .fitting.parameter import Parameter
from .fitting.posterior import sample_posterior
from .fitting.problem import FitOptions
from .fitting.roll_out import roll_out
from .identification.comparison import compare
from .identification.comparison_table import Comparison
from .identification.identify import IdentifyOptions, identify
from .laws.catalogue import law_named
from .laws.law import Law
from .models.model import ReducedModel, load_model
from .models.prediction import law_with_force_input
from .records import PistonRecord
from .records.first_guesses import FirstGuesses
from .records.release import cut_at_release
from .records.sensor import Sensor
from .records.sources import read_record, read_releases

__all__ = [
    "Comparison",
    "DamperCandidate",
    "DesignTarget",
    "DiscoveryOptions",
    "FirstGuesses",
    "FitOptions",
    "IdentifyOptions",
    "Law",
    "LawEstimator",
    "Parameter",
    "PistonRecord",
    "ReducedModel",
    "Sensor",
    "calibrate",
    "compare",
    "cut_at_release",
    "derive",
    "design",
    "discover",
    "fit",
    "identify",
    "law_named",
    "law_with_force_input",
    "load_model",
    "predict",
    "propose_design",
    "read_record",
    "read_releases",
    "roll_out",
    "sample_posterior",
    "score_drops",
    "valid_shaking_range",
    "whole_fall",
]
