"""Fits of a law to records, through the law's differential equation.

`fitting.fit` turns its arguments into a `problem.FitProblem`. `search` follows many starting points
(`start_values`) over fitted times that double in length. `refinement` refits the best one on fine
grids and returns a `refinement.SearchResult`. `assessment` turns this result into a model. Intervals
come from `uncertainty` or `profile_likelihood`, tests of the residuals from `residual_diagnostics`.
"""
