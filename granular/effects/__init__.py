"""Physical effects, one law per file.

Each file has the law's parameters in SI with their source, and its force and energy in natural
units (see `granular.schema.natural_units`). A scene lists the effects that act; the others cost nothing.
"""
