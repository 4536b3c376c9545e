"""Records: the motion of a piston, and the reading of files that instruments write.

A file is read in steps. `formats` reads the bytes and detects the format. The module of the format (`text`
for CSV and similar files, `instruments`, `binary`) makes a `sheet`: columns of numbers with names and units,
in which missing samples are NaN. `roles` chooses the columns of time and coordinate from `headings` or the
user's `options`. `interpret` converts them to SI and notes each guess and change. `record` contains the class
of the resulting motion.
"""
