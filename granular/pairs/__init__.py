"""Sums over pairs of grains: dipoles, discs, and further laws from `granular.effects`."""
