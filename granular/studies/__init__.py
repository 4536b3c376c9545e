"""Studies: one scene under many changes, each case computed once."""
