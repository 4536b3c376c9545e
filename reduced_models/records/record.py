"""The record of a piston, as runs make it and laboratories have it."""

from granular.run.record import PistonRecord

__all__ = ["PistonRecord"]
