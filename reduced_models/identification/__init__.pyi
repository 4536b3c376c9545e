from .data import Figure
from .identification import identify
from .page import comparison_page, identification_page
from .result import Identification

__all__ = [
    "Figure", "Identification", "comparison_page", "identification_page", "identify",
]  # fmt: skip
