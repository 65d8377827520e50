"""The problem's simulations: MuJoCo's warnings about trials that fly apart."""

import logging

import mujoco
import numpy as np
import pytest

from calibration.diagnosis.problem import Problem, Weighting, warnings_logged
from calibration.observations import CHANNELS, observe
from qcar_twin.mechanisms import select
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin
from qcar_twin.vehicle import QCAR

BALL = '<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'


def fly_apart():
  model = mujoco.MjModel.from_xml_string(BALL)
  data = mujoco.MjData(model)
  data.qvel[0] = np.nan
  mujoco.mj_step(model, data)


def test_a_simulation_that_flies_apart_is_logged_and_not_printed(capfd, caplog, tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  with caplog.at_level(logging.DEBUG), warnings_logged():
    fly_apart()
  assert "unstable" in caplog.text
  assert capfd.readouterr() == ("", "") and list(tmp_path.iterdir()) == []


def test_what_listened_before_listens_again():
  heard = []
  mujoco.set_mju_user_warning(heard.append)
  try:
    with pytest.raises(KeyError), warnings_logged():
      raise KeyError
    fly_apart()
  finally:
    mujoco.set_mju_user_warning(None)
  assert len(heard) == 1 and "unstable" in heard[0]


def test_fitted_and_judging_residuals_are_those_of_one_simulation_of_everything_to_the_last_bit():
  """MuJoCo's cars don't see each other, however many are stepped together."""
  time = np.arange(0.0, 2.0, 0.01)
  recordings = [
    Recording.from_columns(
      f"run {k}",
      time[: len(time) - 30 * k],
      {
        "motor_voltage": np.full(len(time) - 30 * k, 1.0 + 0.2 * k),
        "steering_command": 0.2 * np.sin((3.0 + k) * time[: len(time) - 30 * k]),
        "motor_speed": np.full(len(time) - 30 * k, 100.0),
        "yaw_rate": np.zeros(len(time) - 30 * k),
      },
      role="identify" if k < 2 else "validate",
    )
    for k in range(3)
  ]
  twin = Twin(QCAR, select(["steering_delay", "battery_discharge", "imu_latency"]), threads=1)
  observations = observe(recordings, QCAR)
  weighting = Weighting(np.ones(len(CHANNELS)), np.ones(len(CHANNELS)), np.ones(len(observations)))
  fitted = int(np.sum(observations.recording < 2))
  problem = Problem(twin, observations, weighting, fitted)
  theta = np.stack([twin.parameters.nominal] * 3)
  theta[1, twin.parameters.index("steering_delay")] = 0.04
  theta[2, twin.parameters.index("imu_latency")] = 0.03
  everything = problem.residual(theta)
  np.testing.assert_array_equal(problem.fitted_residual(theta), everything[:, :fitted])
  np.testing.assert_array_equal(problem.judging_residual(theta), everything[:, fitted:])
  assert len(np.unique(everything, axis=0)) == 3 and np.isfinite(everything).all()
  alone = Problem(twin, observations, weighting, len(observations))
  assert alone.judging_residual(theta).shape == (3, 0)
