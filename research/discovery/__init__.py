"""Benchmark of `discover`, PySINDy and pyoperon on noisy records of fourteen synthetic systems."""
