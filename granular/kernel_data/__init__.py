"""Data of the kernels: state of a run, constants, and compensated sums."""
