"""Campaigns with committed results: long runs, their results, and the pages' text on them.

``python -m research.NAME`` in a checkout shows the committed results of a campaign; the package is
not installed.
"""
