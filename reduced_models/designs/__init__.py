"""Dampers for a wanted frequency and damping: maps from a study, proposals, checks."""
