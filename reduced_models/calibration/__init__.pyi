from .calibration import calibrate

__all__ = [
    "calibrate",
]  # fmt: skip
