"""Understeer characteristic of ramp steers: straight for a linear car, bent where the tyres bend."""

import numpy as np
import pytest

from calibration.identification.understeer import understeer_characteristic
from qcar_twin import kinematics
from qcar_twin.bicycle.bicycle import TurningLosses
from qcar_twin.plant import START
from qcar_twin.recordings.recording import Recording
from tests.calibration.identification.bicycle_rig import PERIOD, ROLLING, THETA, VEHICLE, drive


def ramp(side=1.0, **kwargs):
  time = PERIOD * np.arange(1200)
  commands = np.stack([np.full(1200, (THETA[1] * 1.5 / ROLLING + THETA[2]) / THETA[0])] * 2, axis=-1)
  commands[:, 1] = side * np.clip((time - 1.0) / 10.0, 0.0, 1.0) * np.deg2rad(20.0)
  start = np.zeros(len(START))
  start[START.index("velocity_x")] = 1.5
  return drive([("ramp_steer", "identify", "ramp_steer", commands, start)], **kwargs)


def test_linear_car_has_a_straight_line_of_the_closed_form():
  understeer = understeer_characteristic(ramp(), VEHICLE)
  lengths = VEHICLE.cg_to_front, VEHICLE.cg_to_rear
  gradient = kinematics.understeer_gradient(VEHICLE.mass, *lengths, *THETA[3:])
  exact = kinematics.steering_per_lateral_acceleration(understeer.speed, sum(lengths), gradient)
  np.testing.assert_allclose(understeer.slope, exact, rtol=0.03)
  assert understeer.linear_limit == understeer.reached > 2.0
  np.testing.assert_allclose(understeer.angle[2:], understeer.slope * np.array(understeer.accel[2:]), rtol=0.02)


def test_steering_loss_ends_the_linear_range():
  bent = understeer_characteristic(ramp(losses=TurningLosses(steering=1.5)), VEHICLE)
  assert 1.2 < bent.linear_limit < 0.9 * bent.reached


@pytest.mark.parametrize("channels", [("motor_speed", "yaw_rate"), ("speed", "accel_y")])
def test_either_lateral_channel_and_either_side_will_do(channels):
  left, right = (understeer_characteristic(ramp(side, channels=channels), VEHICLE) for side in (1.0, -1.0))
  np.testing.assert_allclose(left.slope, right.slope, rtol=0.02)
  np.testing.assert_allclose(left.slope, understeer_characteristic(ramp(), VEHICLE).slope, rtol=0.03)


def test_without_a_speed_there_is_no_characteristic():
  assert understeer_characteristic(ramp(channels=("yaw_rate", "accel_y")), VEHICLE) is None


def test_noise_and_bias_change_little():
  (run,) = ramp(noise=1.0)
  columns = {name: run[name].value for name in run.channels}
  columns["accel_y"] = columns["accel_y"] + 0.05
  biased = Recording.from_columns("biased", run["accel_y"].time, columns, manoeuvre="ramp_steer")
  clean, noisy = (understeer_characteristic(r, VEHICLE) for r in (ramp(), [biased]))
  np.testing.assert_allclose(noisy.slope, clean.slope, rtol=0.03)


def test_without_a_ramp_or_without_turning_there_is_none():
  assert understeer_characteristic([], VEHICLE) is None
  time = PERIOD * np.arange(300)
  straight = {"motor_speed": 400.0 + 0 * time, "accel_y": 0 * time, "steering_command": 0 * time}
  run = Recording.from_columns("straight", time, straight, manoeuvre="ramp_steer")
  assert understeer_characteristic([run], VEHICLE) is None
