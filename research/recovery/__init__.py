"""Test whether fits reach the true optimum: thirteen synthetic systems with noise, compared with SciPy."""
