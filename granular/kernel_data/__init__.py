"""What kernels see: the state that a run changes, its constants, and sums without rounding."""
