"""Campaigns: long series of simulations whose results are committed, with the texts made from the results.

``python -m research.NAME`` in a checkout shows the committed results of a campaign; the package is
not installed.
"""
