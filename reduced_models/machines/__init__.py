"""The identified law at work on a machine: responses in milliseconds, and designs from them."""

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
    "PredictedResponse",
    "SmallSwing",
    "design_for",
    "predicted_response",
]
