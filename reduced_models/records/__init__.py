"""Records of a piston, and what can be read off them without a law."""

from granular.records.record import PistonRecord

__all__ = ["PistonRecord"]
