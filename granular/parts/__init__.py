"""Properties of commercial parts, by closed formulas in SI units: magnets, liquids, films, glass plates."""
