"""The identified law at work on a machine: responses in milliseconds, and designs from them."""

from reduced_models.machines.bed_element import export_bed
from reduced_models.machines.design import design_for
from reduced_models.machines.response import predicted_response
from reduced_models.machines.response_comparison import compare_response

__all__ = ["compare_response", "design_for", "export_bed", "predicted_response"]
