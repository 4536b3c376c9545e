from .bed_element import export_bed
from .design import design_for
from .response import predicted_response
from .response_comparison import compare_response

__all__ = ["compare_response", "design_for", "export_bed", "predicted_response"]
