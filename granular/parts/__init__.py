"""Commercial parts: magnets, liquids, films and plates, in closed form and SI units."""
