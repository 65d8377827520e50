"""A design of runs of two seconds, for commands that make a session of an independent car."""

import numpy as np

from calibration.concealed.laboratory import manoeuvres as m


def short(rng: np.random.Generator) -> list[m.Manoeuvre]:
  """Every role; steps, a circle and free driving."""
  return [
    m.standstill(1.0),
    m.voltage_step(1.5, "identify", 2.0),
    m.circles(0.4, 22.0, 2.0, "identify", "circles_slow"),
    m.oval(1.0, 2.0, "validate"),
    m.free_drive(rng, 2.0, "holdout", "free_drive"),
  ]
