"""Fits to public benchmarks of nonlinear system identification, compared with published errors."""
