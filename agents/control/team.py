"""Several controllers driving the same case in one simulation, each its own group of cars, all with the same noise."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Controller, Situation
from qcar_twin.envs.driven_cars import one_of
from qcar_twin.sensors.base import Sensor
from qcar_twin.sensors.suite import Reading, SensorSuite

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Team:
  """Controllers side by side.

  Attributes:
    members: each drives `each` neighbouring cars, in order.
  """

  members: tuple[Controller, ...]
  each: int
  name: str = "team"

  def steer(self, situation: Situation) -> Array:
    """Steering commands of all cars, rad, (members * each,)."""
    groups = (slice(i * self.each, (i + 1) * self.each) for i in range(len(self.members)))
    parts = [member.steer(group_of(situation, g)) for member, g in zip(self.members, groups, strict=True)]
    return np.concatenate(parts)


def group_of(situation: Situation, which: slice) -> Situation:
  """The same instant for some of the cars."""
  return dataclasses.replace(
    situation,
    arc_length=situation.arc_length[which],
    errors=one_of(situation.errors, which),
    speed=situation.speed[which],
    steering=situation.steering[which],
    past=situation.past[which],
    recent=situation.recent and situation.recent.of(which),
  )


class EqualSensors:
  """Sensors of several groups of cars; car k of every group has the same noise.

  Args:
    sensors: by name.
    groups, each: how many, and cars in each.
    seed: of every group.
  """

  def __init__(self, sensors: dict[str, Sensor], groups: int, each: int, seed: int):
    self.count, self._each = groups * each, each
    self._suites = [SensorSuite(sensors, each, seed) for _ in range(groups)]
    self.period = self._suites[0].period

  def restart(self, which: NDArray[np.bool_], signals: Array) -> None:
    for suite, group in self._groups():
      suite.restart(which[group], signals[group])

  def measure(self, signals: Array) -> list[Reading]:
    groups = [suite.measure(signals[group]) for suite, group in self._groups()]
    return [
      Reading(parts[0].channels, parts[0].age, np.concatenate([part.values for part in parts]))
      for parts in zip(*groups, strict=True)
    ]

  def _groups(self) -> list[tuple[SensorSuite, slice]]:
    return [(suite, slice(i * self._each, (i + 1) * self._each)) for i, suite in enumerate(self._suites)]
