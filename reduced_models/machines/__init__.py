"""The identified law at work on a machine: responses in milliseconds, and designs from them."""

from reduced_models.machines.beside import LawAtPeak, LawBeside, law_beside
from reduced_models.machines.design_for import DamperDesign, design_for
from reduced_models.machines.predicted import (
    BedOnHost,
    PredictedResponse,
    SmallSwing,
    predicted_response,
)

__all__ = [
    "BedOnHost",
    "DamperDesign",
    "LawAtPeak",
    "LawBeside",
    "PredictedResponse",
    "SmallSwing",
    "design_for",
    "law_beside",
    "predicted_response",
]
