"""Calibration of the twin, with stages that are kept."""

from calibration.twin_calibration.calibration import Calibration, calibrate

__all__ = ["Calibration", "calibrate"]
