"""Data of the compiled loop: state of a run, constants, and compensated sums."""
