"""Test whether fits reach the true optimum for thirteen synthetic noisy systems, compared with SciPy."""
