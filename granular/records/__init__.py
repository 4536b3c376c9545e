"""Records: the motion of a piston, and the reading of files that instruments write.

A file is read in steps. `formats` detects the format. A module for this format (`text` for CSV and similar
files, `instruments`, `binary`) reads a table, called a `sheet`: columns of numbers with names and units, in
which missing samples are NaN. `roles` chooses the columns of time and coordinate by the user's `options`, or
else by their names (`headings`). `interpret` converts the columns to SI and notes each guess and change.
`record` defines the resulting `PistonRecord`.
"""
