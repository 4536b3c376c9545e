"""A part that needs what is not there."""

raise RuntimeError("the driver\nof the bench is missing")
