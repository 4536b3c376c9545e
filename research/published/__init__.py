"""Comparison of de Paula's published values with the toolkit's values, each with scatter and a verdict."""
