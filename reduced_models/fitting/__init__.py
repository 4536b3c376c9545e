"""Fits of a law to records, through the law's differential equation.

`fitting.fit` reads what is asked into a `problem.FitProblem`; `search` follows many starts over
horizons that double (`start_values`), and `refinement` brings the best one on fine
grids, as a `refinement.SearchResult`. `assessment` makes a model of it: with `uncertainty` or
`profile_likelihood` for intervals, and `residual_diagnostics` of the residuals.
"""
