"""Code shared by all three packages, such as errors, files, registries, pages, figures and stop signals."""
