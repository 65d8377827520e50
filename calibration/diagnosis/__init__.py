"""Where simulation and recordings differ, what physics was left out, and what the fit gains by it."""

from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.pipeline import diagnose

__all__ = ["Diagnosis", "Outcome", "diagnose"]
