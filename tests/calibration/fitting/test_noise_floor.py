"""Noise while driving is told from motion."""

import numpy as np
import pytest

from calibration.fitting.noise_floor import driving_noise, residual_floor
from qcar_twin.recordings.recording import Recording, Stream


def drive(noise, seed=0, spikes=0.0, rate=100.0):
  rng = np.random.default_rng(seed)
  time = np.arange(0.0, 30.0, 1.0 / rate)
  speed = 30.0 * (1.0 - np.cos(0.8 * time)) + noise["motor_speed"] * rng.standard_normal(len(time))
  yaw_rate = 2.0 * np.sin(3.0 * time) + noise["yaw_rate"] * rng.standard_normal(len(time))
  yaw_rate[rng.random(len(time)) < spikes] += 5.0
  values = {"motor_voltage": np.full(len(time), 2.0), "motor_speed": speed, "yaw_rate": yaw_rate}
  return Recording("drive", {name: Stream(time, value) for name, value in values.items()})


@pytest.mark.parametrize("level", [0.005, 0.02, 0.1])
def test_white_noise_is_found_beside_motion(level):
  noise = driving_noise([drive({"motor_speed": 40.0 * level, "yaw_rate": level})])
  assert noise["yaw_rate"] == pytest.approx(level, rel=0.1)
  assert noise["motor_speed"] == pytest.approx(40.0 * level, rel=0.1)
  assert "motor_voltage" not in noise


def test_motion_without_noise_makes_next_to_none():
  noise = driving_noise([drive({"motor_speed": 0.0, "yaw_rate": 0.0})])
  assert noise["yaw_rate"] < 1e-6 and noise["motor_speed"] < 1e-6


def test_spikes_do_not_matter():
  assert driving_noise([drive({"motor_speed": 0.1, "yaw_rate": 0.02}, spikes=0.01)])["yaw_rate"] == pytest.approx(
    0.02, rel=0.15
  )


def test_a_displacement_carries_two_poses():
  floor = residual_floor({"pose_x": 0.003, "pose_y": 0.004, "pose_yaw": 0.01})
  assert floor["pose_forward"] == floor["pose_left"] == pytest.approx(0.005)
  assert floor["pose_turn"] == pytest.approx(0.01 * np.sqrt(2.0))
