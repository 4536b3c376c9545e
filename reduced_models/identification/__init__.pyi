from .data import Figure as Figure
from .identification import identify as identify
from .page import comparison_page as comparison_page
from .page import identification_page as identification_page
from .result import Identification as Identification
