"""Effective temperature of a bed, and the relation of defects to forces and slip."""
