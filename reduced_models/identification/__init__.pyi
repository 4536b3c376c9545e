from .data import Figure as Figure
from .identification import identify as identify
from .result import Identification as Identification
