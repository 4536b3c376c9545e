"""Commercial parts in closed form and SI units: magnets, liquids, liquid films and glass plates."""
