"""The problem's simulations: MuJoCo's warnings about trials that fly apart."""

import dataclasses
import logging

import mujoco
import numpy as np
import pytest

from calibration.copies import filled
from calibration.fitting import likelihood
from calibration.fitting.likelihood import Problem, Weighting, warnings_logged, weighting_from
from calibration.fitting.observations import CHANNELS, observe
from calibration.fitting.surrogate import Surrogate
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

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


@pytest.fixture(scope="module")
def problem() -> Problem:
  """Three recordings of different length, of which the last only judges."""
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
  return Problem(twin, observations, weighting, int(np.sum(observations.recording < 2)))


@pytest.fixture(scope="module")
def theta(problem: Problem) -> np.ndarray:
  theta = np.stack([problem.parameters.nominal] * 3)
  theta[1, problem.parameters.index("steering_delay")] = 0.04
  theta[2, problem.parameters.index("imu_latency")] = 0.03
  return theta


def test_fitted_and_judging_residuals_are_those_of_one_simulation_of_everything_to_the_last_bit(problem, theta):
  """MuJoCo's cars don't see each other, however many are stepped together."""
  everything = problem.residual(theta)
  np.testing.assert_array_equal(problem.fitted_residual(theta), everything[:, : problem.n_train])
  np.testing.assert_array_equal(problem.judging_residual(theta), everything[:, problem.n_train :])
  assert len(np.unique(everything, axis=0)) == 3 and np.isfinite(everything).all()
  alone = Problem(problem.twin, problem.observations, problem.weighting, len(problem.observations))
  assert alone.judging_residual(theta).shape == (3, 0)


@pytest.mark.parametrize("kind", ["reduced", "put right", "guarded"])
def test_residuals_are_the_same_to_the_last_bit_whatever_the_number_of_processes(problem, theta, kind, monkeypatch):
  twin = Twin(QCAR, problem.twin.mechanisms, substeps=2, threads=0)
  stretches = problem.observations.stretches.segments
  first = (stretches.recording[0], float(stretches.offset[0]))
  searched = {
    "reduced": lambda: twin.on("reduced"),
    "put right": lambda: Surrogate(twin).at(theta[1]),
    "guarded": lambda: Surrogate(twin, guarded=[first]).at(theta[1]),
  }[kind]
  many, shares = np.tile(theta, (3, 1)) * np.linspace(1.0, 1.1, 9)[:, None], []
  fill = lambda work, rows, columns, workers: shares.append(workers) or filled(work, rows, columns, workers)
  monkeypatch.setattr(likelihood, "filled", fill)
  monkeypatch.setattr(likelihood, "copies", lambda: 3)
  alone = Problem(searched(), problem.observations, problem.weighting, problem.n_train).residual(many)
  monkeypatch.setattr(likelihood, "_WORTH_A_COPY", 0)
  together = Problem(searched(), problem.observations, problem.weighting, problem.n_train).residual(many)
  np.testing.assert_array_equal(together, alone)
  assert shares == [1, 3] and len(np.unique(alone, axis=0)) == 9


def test_a_cost_is_that_of_the_residual_where_it_stays_below_its_limit(problem, theta):
  exact = 0.5 * np.sum(np.square(problem.fitted_residual(theta)), axis=1)
  np.testing.assert_allclose(problem.fitted_cost(theta, np.full(3, np.inf)), exact, rtol=1e-12)
  costs = problem.fitted_cost(theta, exact * [1.001, 0.999, 0.0])
  assert costs[0] == pytest.approx(exact[0], rel=1e-12) and np.isinf(costs[1:]).all()


def test_what_costs_too_much_is_not_simulated_to_the_end(problem, theta, monkeypatch):
  simulated = []
  rollout = problem.twin.rollout
  seen = lambda thetas, segments: simulated.append((len(thetas), segments.recording)) or rollout(thetas, segments)
  monkeypatch.setattr(problem.twin, "rollout", seen)
  problem.fitted_cost(theta, np.array([np.inf, 1.0, 1.0]))
  assert simulated == [(3, ("run 0",)), (1, ("run 1",))]


def test_a_trial_that_flies_apart_costs_much_and_not_infinitely(problem, theta, monkeypatch):
  """What is squared in a solver must stay finite, whatever a simulation says."""
  here = theta[:1]
  usual = problem.predict(here)
  for wild in (np.nan, np.inf, -np.inf, 1e200, -1e200):
    signals = usual.signals.copy()
    signals[..., 50:, :] = wild
    monkeypatch.setattr(problem, "_predict", lambda *given, s=signals: dataclasses.replace(usual, signals=s))
    residual = problem.residual(here)[0]
    assert np.isfinite(residual @ residual) and np.abs(residual).max() == pytest.approx(1e3)


class Values:
  """So many values of one channel, ten a second."""

  horizon = 1.0

  def __init__(self, count):
    self.channel, self.recording, self.time = np.zeros(count, int), np.zeros(count, int), 0.1 * np.arange(count)

  def __len__(self):
    return len(self.time)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_where_a_model_flies_apart_nothing_is_learnt_of_the_scatter(bad):
  raw, values = np.random.default_rng(3).normal(0.0, 0.2, 400), Values(400)
  whole, apart = (weighting_from(values, r, {}) for r in (raw, np.where(np.arange(400) % 4 == 0, bad, raw)))
  assert apart.std[0] == pytest.approx(whole.std[0], rel=0.15)
  assert np.isfinite(apart.spike).all() and apart.spike[::4].max() < 1e-100 and apart.spike[1::4].min() > 0.5


def test_a_model_that_flies_apart_everywhere_weighs_by_the_sensors_noise():
  assert weighting_from(Values(9), np.full(9, np.nan), {CHANNELS[0]: 0.3}).std[0] == 0.3
