"""Records of a piston, and their analysis without a law."""

from granular.records.record import PistonRecord

__all__ = ["PistonRecord"]
