"""Effects are also tried on a twin that was not bent: fitted where they explain much, left alone elsewhere."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis.search.multistart import _about, _shared, multistart_models, unbent
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import catalogue
from tests.calibration.diagnosis import diagnosis_rig as rig


def sought_far(pool, monkeypatch, *names):
  for name in names:
    monkeypatch.setattr(type(pool.problem.mechanism(name)), "sought_far", True)


def test_a_large_effect_is_fitted_to_its_minimum(offset_pool, monkeypatch):
  sought_far(offset_pool, monkeypatch, "steering_offset", "side_force")
  found = multistart_models(offset_pool.problem, offset_pool.base, rig.BASE, ["steering_offset", "side_force"])
  model = next(m for m in found if m.mechanisms == ("steering_offset",))
  exact = offset_pool.models[frozenset(["steering_offset"])]
  assert_allclose(model.values, exact.values, rtol=1e-3)
  assert model.cost == pytest.approx(exact.cost, rel=1e-6)


def test_nothing_is_fitted_where_nothing_is_gained(clean_pool, monkeypatch):
  sought_far(clean_pool, monkeypatch, "steering_offset", "side_force")
  assert multistart_models(clean_pool.problem, clean_pool.base, rig.BASE, ["steering_offset", "side_force"]) == []


def test_what_is_not_considered_is_not_tried(offset_pool, monkeypatch):
  sought_far(offset_pool, monkeypatch, "steering_offset")
  assert multistart_models(offset_pool.problem, offset_pool.base, rig.BASE, ["side_force"]) == []


def moved(base, name, sigmas):
  values = base.values.copy()
  values[base.free.index(name)] += sigmas * rig.BASE[name].std
  theta = base.theta.copy()
  theta[base.free.index(name)] = values[base.free.index(name)]
  return dataclasses.replace(base, values=values, theta=theta)


def test_only_what_was_measured_and_moved_beyond_belief_is_put_back(offset_pool):
  straight = moved(offset_pool.base, "mass", -unmoved(offset_pool.base, "mass"))
  assert unbent(straight, rig.BASE) == {}
  assert unbent(moved(straight, "mass", 1.5), rig.BASE) == {}
  assert unbent(moved(straight, "mass", -2.5), rig.BASE) == {"mass": rig.BASE["mass"].nominal}
  assert rig.BASE["motor_damping"].std is None  # nobody measured it, so nothing it does is beyond belief


def unmoved(base, name):
  return (base.estimate(name)[0] - rig.BASE[name].nominal) / rig.BASE[name].std


def test_the_likely_are_tried_where_a_measured_parameter_was_bent(offset_pool):
  """Without delays and with nothing bent nothing is tried; a bent mass lets the likely one in, to its exact minimum."""
  base = moved(offset_pool.base, "mass", -unmoved(offset_pool.base, "mass"))
  assert multistart_models(offset_pool.problem, base, rig.BASE, [], ["steering_offset"]) == []
  (model,) = multistart_models(offset_pool.problem, moved(base, "mass", 4.0), rig.BASE, [], ["steering_offset"])
  exact = offset_pool.models[frozenset(["steering_offset"])]
  assert model.mechanisms == ("steering_offset",) and model.cost == pytest.approx(exact.cost, rel=1e-6)


def test_everything_considered_is_tried_where_a_measured_parameter_was_bent(offset_pool):
  """However little the scan saw of it from the bent twin; what takes many starts must be likely to be tried."""
  base = moved(offset_pool.base, "mass", 4.0 - unmoved(offset_pool.base, "mass"))
  (model,) = multistart_models(offset_pool.problem, base, rig.BASE, ["steering_offset"])
  exact = offset_pool.models[frozenset(["steering_offset"])]
  assert model.mechanisms == ("steering_offset",) and model.cost == pytest.approx(exact.cost, rel=1e-6)


def test_slip_along_is_tried_where_what_the_drive_bent_was_put_back():
  """A soft tread is imitated by the longitudinal stiffness, which is put back with the drive's parameters."""
  problem, names = SimpleNamespace(mechanism=catalogue().__getitem__), ("longitudinal_slip", "drive_lag", "payload")
  assert _about(problem, names, True) == ["longitudinal_slip", "drive_lag"]
  assert _about(problem, names, False) == ["payload"]


def test_of_what_takes_many_starts_only_the_likely_are_tried(offset_pool, monkeypatch):
  base = moved(offset_pool.base, "mass", 4.0 - unmoved(offset_pool.base, "mass"))
  monkeypatch.setattr(
    type(offset_pool.problem.mechanism("steering_offset")), "initial_guesses", lambda self, driving: ({}, {})
  )
  assert multistart_models(offset_pool.problem, base, rig.BASE, ["steering_offset"]) == []
  assert len(multistart_models(offset_pool.problem, base, rig.BASE, ["steering_offset"], ["steering_offset"])) == 1


def test_what_nothing_speaks_for_must_begin_below_the_recalibrated_twin(offset_pool):
  base = moved(offset_pool.base, "mass", 4.0 - unmoved(offset_pool.base, "mass"))
  exact, fitted = offset_pool.models[frozenset(["steering_offset"])], base.n_train
  lower = np.sqrt(0.7) * np.linalg.norm(exact.residual[:fitted]) / np.linalg.norm(base.residual[:fitted])
  sunk = dataclasses.replace(base, residual=lower * base.residual)
  assert multistart_models(offset_pool.problem, sunk, rig.BASE, ["steering_offset"]) == []
  assert len(multistart_models(offset_pool.problem, sunk, rig.BASE, ["steering_offset"], ["steering_offset"])) == 1


AGES = ("encoder_latency", "imu_latency", "pose_latency")


@pytest.mark.parametrize(
  "values, measured, tried",
  [
    ((0.043, 0.048, 0.0), {"motor_speed", "yaw_rate"}, (0.04, 0.043, 0.05)),  # without a pose that says otherwise
    ((0.043, 0.048, 0.004), {"motor_speed", "yaw_rate", "pose_forward"}, (0.004, 0.01)),
    ((-0.004, 0.048, 0.0), {"motor_speed", "yaw_rate"}, ()),  # they have none in common
    ((0.043, 0.048, 0.0), {"speed", "yaw_rate"}, (0.04, 0.043, 0.05)),  # a speed is as old as the motor's
    ((0.04, 0.04, 0.0), {"accel_x"}, ()),  # no age of what was measured
  ],
)
def test_what_all_ages_have_in_common_is_tried_as_a_delay_of_the_commands(values, measured, tried):
  ages = ParameterSet(catalogue()[name].parameters[0] for name in AGES)
  problem = SimpleNamespace(
    mechanism=catalogue().__getitem__,
    observations=SimpleNamespace(present=measured),
    twin=SimpleNamespace(period=0.01),
  )
  base = SimpleNamespace(free=ages, values=np.array(values))
  starts = _shared(problem, base, "command_delay")
  assert [start["command_delay"] for start in starts] == pytest.approx(tried)
  for start, delay in zip(starts, tried, strict=True):
    left = {
      n: v - delay for n, v in zip(AGES, values, strict=True) if n != "pose_latency" or "pose_forward" in measured
    }
    assert {n: start[n] for n in left} == pytest.approx(left)
