"""Parameters that differ from session to session act in their own session, and nowhere else."""

import numpy as np
import pytest

from qcar_twin.plant import START, Segments
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.sessions import SessionShifts
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
SHIFTS = SessionShifts({"a": "monday", "b": "tuesday"}, {"steering_offset": 0.02})


def drive() -> Segments:
  """Three recordings of one manoeuvre; nobody knows the third one's session."""
  commands = np.tile([1.5, 0.1], (3, 120, 1))
  return Segments(commands, np.zeros((3, len(START))), np.full(3, 120), 0.01, ("a", "b", "c"), np.zeros(3))


@pytest.fixture(scope="module")
def twin() -> Twin:
  return Twin(CAR, select(["steering_offset"]), substeps=2, engine="reduced", sessions=SHIFTS)


def test_each_session_has_its_own(twin: Twin):
  plain = Twin(CAR, select(["steering_offset"]), substeps=2, engine="reduced")
  shifted = twin.parameters.vector({"steering_offset": 0.01, "steering_offset@tuesday": -0.03})
  together = twin.rollout(shifted, drive()).signals[0]
  monday, tuesday, mean = (
    plain.rollout(plain.parameters.vector({"steering_offset": value}), drive()).signals[0]
    for value in (0.01, -0.02, -0.005)
  )
  np.testing.assert_array_equal(together[0], monday[0])
  np.testing.assert_allclose(together[1], tuesday[1], rtol=1e-9, atol=1e-9)  # 0.01 - 0.03 is -0.02 to rounding
  np.testing.assert_allclose(together[2], mean[2], rtol=1e-9, atol=1e-9)  # nobody knows its session
  assert np.abs(tuesday[1] - monday[1]).max() > 0.05


def test_the_mean_car_drives_every_session_as_before_and_keeps_the_mean_when_shifts_are_left_out(twin: Twin):
  theta = twin.parameters.vector(
    {"steering_offset": 0.01, "steering_offset@monday": 0.05, "steering_offset@tuesday": 0.03}
  )
  centred = SHIFTS.mean_car(theta, twin.parameters)
  np.testing.assert_allclose(
    twin.rollout(centred, drive()).signals, twin.rollout(theta, drive()).signals, rtol=1e-9, atol=1e-9
  )
  named = twin.parameters.named(centred)
  assert named["steering_offset"] == pytest.approx(0.05)
  assert named["steering_offset@monday"] == pytest.approx(0.01) == pytest.approx(-named["steering_offset@tuesday"])


def test_the_mean_car_stays_within_bounds(twin: Twin):
  theta = twin.parameters.vector({"steering_offset": 0.19, "steering_offset@monday": 0.06})
  named = twin.parameters.named(SHIFTS.mean_car(theta, twin.parameters))
  assert named["steering_offset"] == 0.2
  assert named["steering_offset@monday"] == pytest.approx(0.05)


def test_without_shifts_it_is_the_same_twin(twin: Twin):
  plain = Twin(CAR, select(["steering_offset"]), substeps=2, engine="reduced")
  expected = plain.rollout(plain.parameters.nominal, drive()).signals
  np.testing.assert_array_equal(twin.rollout(twin.parameters.nominal, drive()).signals, expected)


def test_several_vectors_keep_their_own_shifts(twin: Twin):
  vectors = np.stack([twin.parameters.vector({"steering_offset@monday": v}) for v in (0.0, 0.03)])
  together = twin.rollout(vectors, drive()).signals
  apart = np.stack([twin.rollout(v, drive()).signals[0] for v in vectors])
  np.testing.assert_array_equal(together, apart)
  assert not np.array_equal(together[0, 0], together[1, 0])


def test_parameters_name_the_session_and_keep_the_unit():
  twin = Twin(CAR, select(["steering_offset"]), sessions=SHIFTS)
  shift = twin.parameters["steering_offset@monday"]
  assert (shift.null, shift.unit, shift.std) == (0.0, "rad", 0.02)
  assert twin.on("reduced").parameters.names == twin.parameters.names
