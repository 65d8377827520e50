"""Calibration of the twin, with stages that are kept."""

from calibration.calibrating.calibration import Calibration, calibrate

__all__ = ["Calibration", "calibrate"]
