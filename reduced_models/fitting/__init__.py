"""Fits of a law to records, through the law's differential equation."""
