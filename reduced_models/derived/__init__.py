"""Derive a damper's law from its equilibria and complex roots, without simulating in time."""
