from .design import design_for, export_bed
from .response import compare_response, predicted_response

__all__ = ["compare_response", "design_for", "export_bed", "predicted_response"]
