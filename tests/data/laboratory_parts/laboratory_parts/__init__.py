"""Custom parts of a laboratory, one of each kind."""
