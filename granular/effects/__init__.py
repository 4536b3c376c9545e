"""The physical effects, one law a file.

Each file holds the law's parameters in SI with their source, and its force and energy in natural
units (see `granular.schema.natural_units`). A scene names the effects that act; the others cost nothing.
"""
