"""De Paula's published values beside the toolkit's own, with scatter and a verdict each."""
