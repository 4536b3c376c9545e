"""Programs of others that the benchmark times, one a file.

The wheel leaves this folder out: whoever compares engines has the sources.
"""
