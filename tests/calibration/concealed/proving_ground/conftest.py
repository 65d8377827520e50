"""Small sessions for the tests of the proving ground."""

import numpy as np
import pytest

from calibration.concealed.laboratory import designs
from calibration.concealed.laboratory import manoeuvres as m


def tiny(rng: np.random.Generator) -> list[m.Manoeuvre]:
  """Two seconds each of what stirs most effects."""
  return [
    m.standstill(1.0),
    m.voltage_step(1.5, "identify", 1.0),
    m.excitation(rng, 2.0, "identify", "excitation"),
    m.throttle_in_turn(2.2),
    m.drive_brake(rng, 2.0),
    m.steering_step(12.0, "validate", 2.0),
    m.oval(1.0, 2.0, "holdout"),
  ]


@pytest.fixture(scope="session", autouse=True)
def tiny_design():
  designs.DESIGNS["tiny"] = tiny
  yield
  del designs.DESIGNS["tiny"]
