"""Sums over the pairs of grains: of dipoles, discs, and further laws that `granular.effects` adds."""
