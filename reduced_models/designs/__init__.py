"""Design of dampers for a given frequency and damping: scaling laws, proposals, checks."""
