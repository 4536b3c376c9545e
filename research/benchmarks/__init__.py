"""Public benchmarks of non-linear identification, each by one fit, with the published errors."""
