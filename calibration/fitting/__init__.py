"""The twin fitted to recordings: cut, observed, weighted, minimised."""

from calibration.fitting.noise import noise_models
from calibration.fitting.observations import Observations, observe
from calibration.fitting.optimiser import Fit, fit
from calibration.fitting.recalibration import RecalibratedTwin, begun, recalibrate
from calibration.fitting.windows import Cut

__all__ = ["Cut", "Fit", "Observations", "RecalibratedTwin", "begun", "fit", "noise_models", "observe", "recalibrate"]
