"""Parts of a laboratory's own, one of each kind."""
