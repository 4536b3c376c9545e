"""Commands of ``python -m reduced_models``."""
