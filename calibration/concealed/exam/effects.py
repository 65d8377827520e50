"""What can be concealed in a car of any generator: an effect is a size and what it changes.

An effect acts on a generator's own parameters, on the commands on their way to the car (`commands.py`), or on what
the sensors see (`observed.py`). `right` names the mechanisms of the product's catalogue that count as a right answer;
without any the effect is outside the catalogue. A departure of one of its `figures` counts, too. An effect has no
typical size: its size is searched by what it shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

Signals = Mapping[str, np.ndarray]
Parameters = TypeVar("Parameters")


class Filter(Protocol):
  """What stands between the logged commands and the car during one run; it remembers."""

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    """The commands (drive command, steering angle [rad]) that reach the car in this control period."""
    ...


@dataclass(frozen=True)
class Effect:
  """One kind of effect.

  Attributes:
    part: of the car: steering, drive, tyre, body, ground, sensor.
    how: what it changes, and with that what `act` is.
      parameter: act(parameters, size, later) changes a generator's parameters in place; `later`: second half of a
        session.
      command: act(size, full) makes a `Filter` of one run; `full` is the drive command's limit.
      sensor: act(signals, size) returns other signals, (M,) each on the fine grid.
    right: mechanisms that count as right.
    unit: of the size.
    most: largest size that is possible.
    signed: whether the size may be negative.
    figures: of the vehicle's description, whose departure from what was measured says the same as a right name.
  """

  part: str
  how: Literal["parameter", "command", "sensor"]
  right: tuple[str, ...]
  unit: str
  most: float
  act: Callable[..., Any]
  signed: bool = False
  figures: tuple[str, ...] = ()

  @property
  def answers(self) -> list[str]:
    """All that counts as a right answer: names of mechanisms and of figures."""
    return [*self.right, *self.figures]


@dataclass(frozen=True)
class Concealed:
  """An effect of a size; `name` is its key in the generator's table."""

  name: str
  effect: Effect
  size: float


@dataclass(frozen=True)
class Nuisance:
  """A number of the car without an effect that whoever explains its log may move.

  Attributes:
    act: act(parameters, size, later), as an effect's.
    step: size at which its derivative is taken.
    std: standard deviation of what the owner states of it, in the same unit; infinite where nothing is stated.
  """

  act: Callable[..., Any]
  step: float
  std: float = np.inf


def altered(
  parameters: Parameters, concealed: Sequence[Concealed], moved: Sequence[tuple[Nuisance, float]], later: bool
) -> Parameters:
  """A generator's parameters, changed in place: by nuisances of these sizes, then by what is concealed in them."""
  for act, size in [(n.act, size) for n, size in moved] + [(c.effect.act, c.size) for c in concealed]:
    act(parameters, size, later)
  return parameters


def of_kind(concealed: Sequence[Concealed], how: str) -> list[Concealed]:
  """Those that act this way, in order."""
  return [one for one in concealed if one.effect.how == how]
