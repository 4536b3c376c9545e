"""Benchmark of `discover`: laws found in noisy records of fourteen synthetic systems, with two peers."""
