"""Data of the kernels: the state of a run, its constants, and sums without rounding."""
