"""A part with a missing requirement."""

raise RuntimeError("the driver\nof the bench is missing")
