"""The states of the second car by name."""

from __future__ import annotations

import numpy as np

SCALES = {
  "x": 1.0, "y": 1.0, "z": 0.01, "roll": 0.05, "pitch": 0.05, "yaw": 1.0,
  "u": 1.0, "v": 0.3, "w": 0.1, "p": 1.0, "q": 1.0, "r": 2.0,
  "wheel_fl": 30.0, "wheel_fr": 30.0, "wheel_rl": 30.0, "wheel_rr": 30.0,
  "motor": 300.0, "motor_angle": 100.0, "twist": 0.01, "current": 3.0, "rub": 0.05,
  "reference": 1.0, "polarisation": 0.1,
  "servo": 0.2, "linkage": 0.2,
  "along_fl": 5e-4, "along_fr": 5e-4, "along_rl": 5e-4, "along_rr": 5e-4,
  "across_fl": 5e-4, "across_fr": 5e-4, "across_rl": 5e-4, "across_rr": 5e-4,
}  # fmt: skip
"""State -> a usual size of it, to which the integrator's tolerance is relative. Velocities u, v, w and p, q, r are the
chassis' own, straight and angular, in its axes; the bristles' deflections are along and across the wheels."""
NAMES = tuple(SCALES)


class State:
  """Views of an array (33, n): every state by its name; `wheel` (4, n), `bristle` (2, 4, n)."""

  def __init__(self, array: np.ndarray) -> None:
    self.array = array
    for row, name in enumerate(NAMES):
      setattr(self, name, array[row])
    first, bristle = NAMES.index("wheel_fl"), NAMES.index("along_fl")
    self.wheel = array[first : first + 4]
    self.bristle = array[bristle : bristle + 8].reshape(2, 4, -1)

  def __getattr__(self, name: str) -> np.ndarray:
    raise AttributeError(f"the second car has no state '{name}'; there are {', '.join(NAMES)}")
