"""Speed, side by side on the same arrangement in one run, and growth with the number of grains."""
