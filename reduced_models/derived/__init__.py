"""A damper's law from its equilibria and complex roots, without a time step."""
