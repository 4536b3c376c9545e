"""Physical effects, one law per file.

Each file defines the parameters of its law in SI, with their source, and the force and energy in natural
units (see `granular.schema.natural_units`). A scene lists the effects that act; effects that are not listed
cost nothing.
"""
