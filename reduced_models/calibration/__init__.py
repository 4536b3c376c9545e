"""Calibration of a scene's parameters by fitting simulations to a laboratory record."""
