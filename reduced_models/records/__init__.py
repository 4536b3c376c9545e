"""Records of a piston, and what can be read off them without a law."""
