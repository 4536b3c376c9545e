"""Code shared by all three packages: errors and their texts, files, pages, figures, tables, stop signals."""
