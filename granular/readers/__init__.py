"""Records as instruments write them: what stands in a file, and what it is taken for.

A file is read in two steps. Its *sheet* (`sheet`) is what stands in it: columns of numbers with
their names and units, where lost samples are NaN. Text comes by `delimited` (CSV and its many
kin), other formats by `excel`, `labview`, `matlab` and `parquet`; `opening` tells them apart. What
the columns are taken for (`meaning`) follows from names and units, or from what the user says
(`reading`): which is the time, which the coordinate, and what must be done to them.
"""
