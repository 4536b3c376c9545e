"""What others have measured on beds of repelling magnets, and the same in the toolkit's scenes.

`measurements.toml` lists each one: its source, which figures could be read and which could not, and a scene.
`measurements` runs the one with figures. `sizes` has dampers of five sizes on one curve.
"""
