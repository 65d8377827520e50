"""A fitted twin on recordings that it was not fitted to, by MuJoCo."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.black_box import rms
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.observations import Observations, observe
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.fitting.windows import Cut
from qcar_twin.plant import Prediction
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]


def driven(
  found: RecalibratedTwin, recordings: Sequence[Recording], theta: Array | None = None
) -> tuple[Observations, Prediction, Array]:
  """What was observed, the twin's signals, and predicted minus measured, (M,).

  Args:
    found: the twin.
    recordings: what it drives, free runs from measured starts.
    theta: all parameters, (P,), where they are not the fitted ones.
  """
  twin = found.problem.exact.twin.on("mujoco")
  observations = observe(recordings, twin.vehicle, Cut(command_shift=found.command_shift, most=LONGEST))
  values = found.theta if theta is None else theta
  prediction: Prediction = twin.rollout(values[None], observations.stretches.segments)
  return observations, prediction, observations.predict(prediction)[0] - observations.measured


def error_of(found: RecalibratedTwin, recordings: Sequence[Recording]) -> dict[str, float]:
  """Root mean square error of a fitted twin per channel, in its unit."""
  observations, _, left = driven(found, recordings)
  return rms(observations, left)
