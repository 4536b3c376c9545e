"""Sums over pairs of grains: dipoles, discs, and pair laws that packages add (`granular.effects`)."""
