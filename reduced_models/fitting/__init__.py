"""Fits of a law to records, through the law's differential equation.

`fitting.fit` collects its arguments in a `problem.FitProblem`. `search` fits the first cycles of the
records from many start values (`start_values`), and doubles the fitted time until it covers the
complete records. `refinement` refits the best start on finer time grids and returns a
`refinement.SearchResult`. `assessment` turns this result into a model. `uncertainty` or
`profile_likelihood` computes the intervals; `residual_diagnostics` tests the residuals.
"""
