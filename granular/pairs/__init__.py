"""Sums over the pairs of grains; the law of a pair itself is in `granular.effects`."""
