"""Code used by all three packages, for example for errors, files, registries, pages and figures."""
