"""What any car can hide in its commands and sensors; the small errors of every description, which are no effects."""

from __future__ import annotations

import numpy as np

from .commands import COMMAND_EFFECTS
from .effects import Concealed, Effect
from .observed import SENSOR_EFFECTS

WRAPPED: dict[str, Effect] = COMMAND_EFFECTS | SENSOR_EFFECTS

UNSTATED = {"steering_gain": 0.01, "accel_gain": 0.01, "imu_ahead": 0.003}
"""Standard deviations: road wheels read off a protractor, an accelerometer's data sheet, a place by a ruler [m]."""


def small_errors(rng: np.random.Generator) -> list[Concealed]:
  """The errors of one car's description; every session of an exam has them, those without an effect, too."""
  return [Concealed(name, WRAPPED[name], std * float(rng.standard_normal())) for name, std in UNSTATED.items()]
