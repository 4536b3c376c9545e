"""Published measurements on beds of repelling magnets, compared with the toolkit's scenes.

`measurements.toml` lists each measurement with its source, the figures that could be read, the figures that
could not, and a scene. `measurements` simulates the measurement whose figures could be read. `sizes` tests
whether dampers of five sizes follow the same curve in dimensionless groups.
"""
