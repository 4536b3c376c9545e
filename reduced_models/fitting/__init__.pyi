from .fitting import fit

__all__ = [
    "fit",
]  # fmt: skip
