"""Runs of scenes, and their results in memory and in directories."""
