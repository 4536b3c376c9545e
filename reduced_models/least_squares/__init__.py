"""Least squares of a law's solution and a record: unknowns, residuals, and the search."""
