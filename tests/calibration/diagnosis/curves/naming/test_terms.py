"""What is told of the numbers beside the curves."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import refits
from calibration.diagnosis.curves.naming import terms as module
from calibration.diagnosis.curves.naming.terms import terms
from qcar_twin.parameters import Parameter, ParameterSet

MISSED = refits.Test(t=9.0, nats=300.0, worse=1.2)
SMALL = refits.Test(t=9.0, nats=300.0, worse=1.001)
GONE = refits.Test(t=0.1, nats=0.0, worse=1.0)


def parameter(name, unit="s"):
  return Parameter(name, 0.0, -1.0, 1.0, unit, "x", null=0.0)


def mechanism(name):
  return SimpleNamespace(name=name, parameters=(parameter(name), Parameter(f"{name}_power", 1.0, 0.0, 2.0, "-")))


def told(values, lead=0.0, std=0.001, forms=()):
  free = ParameterSet([parameter(name) for name in values])
  fit = SimpleNamespace(parameters=free, theta=np.array(list(values.values()), float))
  covariance = std**2 * np.eye(len(free))
  return SimpleNamespace(fitted=SimpleNamespace(fit=fit), covariance=covariance, lead=lead, forms=forms)


@pytest.fixture
def before(monkeypatch):
  """A twin that was fitted with three mechanisms, before any went."""
  monkeypatch.setattr(module, "clustered_std", lambda model, observations: np.full(len(model.free), 0.002))
  beside = ("imu_latency", "gyro_scale", "drive_delay")
  base = SimpleNamespace(free=ParameterSet([parameter(n) for n in beside]), values=np.array([0.05, 0.004, 0.03]))
  problem = SimpleNamespace(mechanism=mechanism, observations=None)
  return SimpleNamespace(beside=beside, base=base, problem=problem, forms=())


def by_name(found):
  return {t.name: t for t in found}


def test_a_number_is_there_where_the_twin_is_worse_without_it_by_what_matters(before):
  values = {"imu_latency": 0.05, "gyro_scale": 0.5, "drive_delay": 0.03}
  tests = {"imu_latency": MISSED, "gyro_scale": SMALL, "drive_delay": MISSED}
  found = by_name(terms(told(values), before, tests))
  assert found["imu_latency"].there and found["imu_latency"].error_without == 1.2
  assert not found["gyro_scale"].there and found["gyro_scale"].value == 0.5
  assert "imu_latency_power" not in found


def test_what_the_twin_does_without_is_told_as_it_was(before):
  tests = {"imu_latency": MISSED, "gyro_scale": GONE, "drive_delay": GONE}
  found = by_name(terms(told({"imu_latency": 0.06, "drive_delay": 0.03}), before, tests))
  assert found["imu_latency"].value == 0.06
  assert (found["gyro_scale"].value, found["gyro_scale"].std, found["gyro_scale"].there) == (0.004, 0.002, False)
  assert not found["drive_delay"].there


def test_delays_count_from_where_commands_were_moved_to(before):
  tests = dict.fromkeys(before.beside, MISSED)
  found = by_name(terms(told({"drive_delay": 0.03}, lead=0.02), before, tests))
  assert found["drive_delay"].value == pytest.approx(0.01)
  assert found["drive_delay"].std == pytest.approx(np.hypot(0.001, 0.02 / np.sqrt(12.0)))


def test_forms_that_were_chosen_by_refits_are_there(before):
  before.forms = ("stiction", "motor_heating")
  values = {"stiction": 0.1, "motor_heating": 0.1}
  found = by_name(terms(told(values, forms=before.forms), before, {"stiction": MISSED, "motor_heating": SMALL}))
  assert found["stiction"].there and not found["motor_heating"].there


def test_what_sessions_share_is_told_as_well_as_it_is_known(before):
  """Shared and shifts stand in for each other, and all are known to 0.02; their sums are known to 0.0005."""
  before.beside = ("steering_offset",)
  before.base.free, before.base.values = ParameterSet([parameter("steering_offset")]), np.zeros(1)
  found = told({"steering_offset": 0.004, "steering_offset@a": 0.0305, "steering_offset@b": 0.0295})
  trade = np.array([1.0, -1.0, -1.0])
  found.covariance = 0.0005**2 * np.eye(3) + 0.02**2 * np.outer(trade, trade)
  shared = by_name(terms(found, before, {}))["steering_offset"]
  assert shared.value == pytest.approx(0.034) and shared.std < 0.001 and shared.there
  (first,) = (t for t in terms(found, before, {}) if t.name == "steering_offset@a")
  assert first.value == pytest.approx(0.0005) and first.std < 0.001 and not first.there


def test_sessions_are_told_from_their_mean_and_beyond_chance(before):
  values = {"steering_offset@a": 0.031, "steering_offset@b": 0.029}
  found = by_name(terms(told(values, std=0.0001), before, {}))
  assert found["steering_offset@a"].value == pytest.approx(0.001) and found["steering_offset@a"].there
  assert not by_name(terms(told(values, std=0.01), before, {}))["steering_offset@a"].there
