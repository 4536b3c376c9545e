"""Physical effects, such as dipole forces, drag and walls; each file has one law.

Each file defines the parameters of its law in SI, with their source, and the force and energy in natural
units (see `granular.schema.natural_units`). A scene lists the effects that act; other effects take no
computing time.
"""
