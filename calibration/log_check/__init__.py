"""A log without a model of a car: timing, channels that measure one motion, what the driving can show."""

from calibration.log_check.check import LogCheck, check_log, heed

__all__ = ["LogCheck", "check_log", "heed"]
