"""Third-party programs timed by the benchmark, one per file.

The wheel omits this folder: comparisons of engines need the sources.
"""
