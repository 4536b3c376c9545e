"""Campaigns whose results are committed: long runs, what they gave, and what pages say of them.

``python -m research.NAME`` in a checkout shows the committed results of a campaign; the package is
not installed.
"""
