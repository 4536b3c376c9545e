"""Fits of a law to records, through the law's differential equation.

`fitting.fit` turns its arguments into a `problem.FitProblem`. `search` follows many starts
(`start_values`) over horizons that double, and `refinement` refits the best one on fine grids; the
result is a `refinement.SearchResult`. `assessment` makes a model of it, with intervals by
`uncertainty` or `profile_likelihood` and tests of the residuals by `residual_diagnostics`.
"""
