from .calibration import calibrate as calibrate
