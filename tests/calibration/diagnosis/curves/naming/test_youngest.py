"""Ages count from the youngest sensor."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import youngest
from calibration.diagnosis.curves.naming.youngest import by_the_youngest
from qcar_twin.parameters import Parameter, ParameterSet


def age(name, nominal=0.0, std=0.01):
  return Parameter(name, nominal, -0.12, 0.3, "s", std=std, null=0.0)


@dataclasses.dataclass(frozen=True)
class Fake:
  """Trials of a base with the values of ages."""

  base: SimpleNamespace
  beside: tuple
  clock: str = "pose_latency"
  problem: None = None

  def model(self, forms, start, without):
    rest = [p for p in self.base.free if p.name not in without]
    free = ParameterSet([*rest, *map(age, forms)])
    values = [start.get(n, self.base.value(n) if n in self.base.free else np.nan) for n in free.names]
    return base(free, values)


def base(free, values):
  at = np.array(values, float)
  return SimpleNamespace(free=free, values=at, value=lambda name: float(at[free.index(name)]))


@pytest.fixture
def unmoved(monkeypatch):
  """The same twin in other words is at its minimum."""
  monkeypatch.setattr(youngest, "simulate", lambda problem, models: None)
  monkeypatch.setattr(youngest, "refine", lambda problem, models, steps, full: None)


def trials(**values):
  free = ParameterSet([age(n, nominal=v) for n, v in values.items()])
  return Fake(base(free, list(values.values())), tuple(values))


def test_a_sensor_that_speaks_before_the_clock_makes_the_clock_late(unmoved):
  found = by_the_youngest(trials(encoder_latency=-0.02, imu_latency=0.01, steering_delay=0.03, drive_delay=0.01))
  told = {name: found.base.value(name) for name in found.base.free.names}
  assert told == pytest.approx({"imu_latency": 0.03, "steering_delay": 0.01, "drive_delay": 0.0, "pose_latency": 0.02})
  assert found.clock == "encoder_latency" and set(found.beside) == set(told)


def test_priors_follow_the_clock_and_no_age_falls_below_zero(unmoved):
  free = by_the_youngest(trials(encoder_latency=-0.02, imu_latency=0.01)).base.free
  assert free["imu_latency"].nominal == pytest.approx(0.03) and free["pose_latency"].nominal == pytest.approx(0.02)
  assert free["imu_latency"].std == pytest.approx(np.hypot(0.01, 0.01))
  assert free["imu_latency"].lower == free["pose_latency"].lower == 0.0


def test_a_clock_that_is_the_youngest_stays(unmoved):
  same = trials(encoder_latency=0.0, imu_latency=0.01)
  assert by_the_youngest(same) is same
  assert by_the_youngest(dataclasses.replace(same, base=base(ParameterSet([]), []))).clock == "pose_latency"
