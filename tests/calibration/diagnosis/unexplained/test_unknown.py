"""UNKNOWN as a rival: exact on linear data, finds a sensor's error, stays quiet on noise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis.score import compare
from calibration.diagnosis.unexplained.unknown import smooth_forces, unknown_sensors
from calibration.fitting.optimiser import prior_gradient
from qcar_twin.plant import SIGNALS
from qcar_twin.twin.mechanisms.base import Context
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.qcar_twin.twin.mechanisms.mechanism_bench import CAR


def rivals(pool):
  problem, base = pool.problem, pool.base
  whitening = problem.whiten(np.ones(len(problem.observations)))
  return unknown_sensors(base, problem.observations, problem.predict(base.theta[None]), whitening)


def test_a_sensor_rival_solves_its_normal_equations(offset_pool):
  base = offset_pool.base
  for rival in rivals(offset_pool).values():
    seen = rival.jacobian[: rival.n_train]
    start = np.concatenate([base.values, np.zeros(len(rival.values) - len(base.values))])
    curvature = seen.T @ seen + np.diag(rival.free.deviation_slopes(start) ** 2)
    slope = seen.T @ base.residual[: rival.n_train] + prior_gradient(start, rival.free)
    unit = rival.free.scale  # parameters are many powers of ten apart
    move = -np.linalg.solve(curvature * np.outer(unit, unit), slope * unit) * unit
    assert_allclose(rival.values - start, move, rtol=1e-6, atol=1e-9)
    assert_allclose(rival.residual, base.residual + rival.jacobian @ move, atol=1e-7)
    assert rival.cost <= base.cost + 1e-9


def test_a_sensor_rival_moves_its_own_channel_most(offset_pool):
  observations = offset_pool.problem.observations
  for name, rival in rivals(offset_pool).items():
    own = observations.select(name.removeprefix("unknown_sensor_"))
    added = rival.jacobian[:, len(offset_pool.base.free) :]
    assert np.abs(added[own]).max() > 0
    assert np.abs(added[~own]).max() == 0


def test_a_smooth_sensor_error_is_found_in_its_channel():
  twin = rig.LinearTwin()
  recordings = rig.measure(twin, rig.drive(), {})
  spoilt = []
  for recording in recordings:
    streams = dict(recording.streams)
    speed = 0.003 * recording["motor_speed"].value
    stream = streams["accel_y"]
    streams["accel_y"] = type(stream)(stream.time, stream.value + 0.8 * np.tanh(speed / 1.5))
    spoilt.append(recording.replace(streams=streams))
  pool = rig.pool_of(rig.problem_of(twin, spoilt), mechanisms=())
  gains = {n: compare(r, pool.base, pool.problem.observations) for n, r in rivals(pool).items()}
  best = max(gains, key=lambda n: gains[n].gain)
  assert best == "unknown_sensor_accel_y"
  assert gains[best].gain > 20 and gains[best].t > 2.6


def test_sensor_rivals_gain_nothing_on_noise(clean_pool):
  for rival in rivals(clean_pool).values():
    test = compare(rival, clean_pool.base, clean_pool.problem.observations)
    assert test.gain < 10 and test.t < 2.6


@pytest.mark.parametrize("force", smooth_forces(), ids=lambda f: f.name)
def test_a_smooth_force_acts_on_its_own_degree_and_only_there(force):
  signals = np.zeros((3, len(SIGNALS)))
  signals[:, SIGNALS.index("velocity_x")] = [0.0, 1.0, 1.0]
  signals[:, SIGNALS.index("yaw_rate")] = 0.5
  context = Context(CAR, 0.01, 0.0, signals, np.tile([1.0, 0.1], (3, 1)), *[np.zeros((3, 2))], np.zeros(3),
                    np.zeros((3, 3)), np.zeros(3), np.ones(3), np.ones(3))  # type: ignore[arg-type]  # fmt: skip
  theta = np.zeros((3, len(force.parameters)))
  theta[:, 0] = force.parameters[0].typical
  theta[2] *= 2.0
  wrench = force.wrench(theta, context, {})
  command = force.command(theta, context, {}, np.zeros((3, 2)))
  acted = np.hstack([wrench, command])
  place = ["force_x", "force_y", "moment_z", "voltage", "steering"].index(force.degree)
  assert np.abs(np.delete(acted, place, axis=1)).max() == 0
  assert acted[0, place] == 0  # nothing at standstill
  assert acted[1, place] == pytest.approx(force.parameters[0].typical)
  assert acted[2, place] == pytest.approx(2.0 * acted[1, place])


def test_smooth_forces_declare_null_and_bounds():
  names = [p.name for f in smooth_forces() for p in f.parameters]
  assert len(set(names)) == len(names)
  for force in smooth_forces():
    assert all(p.null == 0.0 and p.lower < 0 < p.upper and p.typical for p in force.parameters)
    assert len(force.parameters) == len(force.terms)
