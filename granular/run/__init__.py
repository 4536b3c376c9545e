"""Runs: from a scene to a trajectory, in memory and in a directory."""
