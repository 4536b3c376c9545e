"""Sums over pairs of grains, for dipoles, discs and pair laws from other packages (`granular.effects`)."""
