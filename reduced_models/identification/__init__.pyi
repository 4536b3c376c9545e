from .page import comparison_page as comparison_page
from .page import identification_page as identification_page
