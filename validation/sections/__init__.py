"""The parts of the report as sections of a page, from their plain data."""
