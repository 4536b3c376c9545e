"""De Paula's published values compared with the toolkit's values, each with scatter and a verdict."""
