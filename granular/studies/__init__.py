"""Studies: many variations of one scene, each case computed once."""
