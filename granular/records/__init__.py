"""Records: a piston's motion, and what it is taken for in files as instruments write them.

A file passes in one direction: `formats` reads its bytes and knows its format; the format's file
(`text` for CSV and its many kin, `instruments`, `binary`) makes a `sheet` of them,
columns of numbers with names and units in which lost samples are NaN; `roles` chooses which column
is the time and which the coordinate, by `headings` or by what the user says (`options`);
`interpret` makes SI of them and says what was done; and `record` holds the motion.
"""
