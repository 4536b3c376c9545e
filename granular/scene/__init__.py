"""Scenes: immutable, validated descriptions of a bed, its piston and its protocol."""
