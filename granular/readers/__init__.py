"""Records as instruments write them: what stands in a file, and what it is taken for.

A file passes in one direction: `file_formats` reads its bytes and knows its format; the format's
file (`delimited` for CSV and its many kin, `workbook`, `instruments`, `matlab`, `parquet`) makes a
`sheet` of them, columns of numbers with names and units in which lost samples are NaN;
`column_roles` chooses which column is the time and which the coordinate, by `column_headers` or by
what the user says (`read_options`); and `sheet_interpretation` makes SI of them, says what was done,
and hands on what a record is made from.
"""
