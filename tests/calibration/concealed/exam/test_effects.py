"""What is concealed does what it says, and its right names are the catalogue's."""

import numpy as np
import pytest

from calibration.concealed.exam.cases import effects_of
from calibration.concealed.exam.commands import COMMAND_EFFECTS
from calibration.concealed.exam.observed import SENSOR_EFFECTS, STEP
from calibration.concealed.exam.session import GENERATORS
from qcar_twin.twin.mechanisms import catalogue


@pytest.mark.parametrize("generator", sorted(GENERATORS))
def test_right_names_are_in_the_catalogue_and_four_effects_are_outside_it(generator):
  table = effects_of(generator)
  assert {name for effect in table.values() for name in effect.right} <= set(catalogue())
  assert sum(not effect.right for effect in table.values()) >= 4
  assert len({effect.part for effect in table.values() if effect.right}) >= 4


def answered(name, size, told, channel=1):
  """What reaches the car of a series of commands."""
  change = COMMAND_EFFECTS[name].act(size, 10.0)
  pairs = [(value, 0.0) if channel == 0 else (0.0, value) for value in told]
  return np.array([change(*pair)[channel] for pair in pairs])


def test_a_dead_time_between_two_periods_is_their_weighed_mean():
  step = np.repeat([0.0, 1.0], 10)
  out = answered("steering_dead_time", 0.024, step)
  assert out[10:14] == pytest.approx([0.0, 0.0, 0.6, 1.0])
  assert 0.01 * (step - out).sum() == pytest.approx(0.024)


def test_play_and_band_hold_the_wheels():
  there_and_back = np.concatenate([np.linspace(0.0, 0.2, 41), np.linspace(0.2, -0.2, 81)])
  play = answered("steering_play", 0.04, there_and_back)
  assert play[40] == pytest.approx(0.18) and play[-1] == pytest.approx(-0.18)
  band = answered("steering_band", 0.03, there_and_back)
  assert np.abs(band - there_and_back).max() <= 0.03 + 1e-9 and len(set(np.round(band, 6))) < 20


def test_drive_effects_keep_what_they_should():
  full = np.ones(400)
  assert answered("drive_dropouts", 0.1, full, 0).mean() == pytest.approx(0.9)
  assert answered("drive_dropouts", 0.0025, full, 0).mean() == pytest.approx(0.9975)
  ramp = answered("drive_ramp", 0.1, full, 0)
  assert ramp[9] == pytest.approx(1.0 - np.exp(-1.0))
  assert COMMAND_EFFECTS["torque_steer"].act(0.02, 10.0)(5.0, 0.1) == (5.0, pytest.approx(0.11))


@pytest.fixture
def turning():
  """A car on a circle of 2 m whose speed rises, seen on the fine grid."""
  time = STEP * np.arange(3001)
  speed, radius = 1.0 + 0.5 * time, 2.0
  way = time + 0.25 * time**2
  yaw = way / radius
  return time, {
    "x": radius * np.sin(yaw), "y": radius * (1.0 - np.cos(yaw)), "yaw": yaw, "yaw_rate": speed / radius,
    "accel_x": np.full(len(time), 0.5), "accel_y": speed**2 / radius, "motor": 10.0 * speed, "road": 0.0 * time,
  }  # fmt: skip


def test_an_age_and_a_drifting_clock_show_what_was(turning):
  time, signals = turning
  late = SENSOR_EFFECTS["encoder_age"].act(signals, 0.05)
  assert late["motor"][100:] == pytest.approx(signals["motor"][50:-50]) and late["x"] is signals["x"]
  drifted = SENSOR_EFFECTS["clock_drift"].act(signals, 0.01)
  assert drifted["motor"] == pytest.approx(10.0 * (1.0 + 0.5 * time / 1.01))
  assert drifted["road"] is signals["road"]


def test_an_imu_that_sits_ahead_feels_the_turn(turning):
  _, signals = turning
  ahead = SENSOR_EFFECTS["imu_ahead"].act(signals, 0.1)
  assert ahead["accel_x"] == pytest.approx(0.5 - 0.1 * signals["yaw_rate"] ** 2)
  assert ahead["accel_y"] == pytest.approx(signals["accel_y"] + 0.1 * 0.25)
  turned = SENSOR_EFFECTS["imu_turned"].act(signals, 0.2)
  assert np.hypot(turned["accel_x"], turned["accel_y"]) == pytest.approx(np.hypot(0.5, signals["accel_y"]))
