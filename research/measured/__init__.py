"""Published measurements on beds of repelling magnets, compared with the toolkit's scenes.

`measurements.toml` lists each measurement: its source, the figures that could be read and those that could
not, and a scene. `measurements` simulates the one with figures. `sizes` collapses dampers of five sizes on
one curve.
"""
