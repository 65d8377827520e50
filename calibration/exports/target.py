"""What a twin can be exported to: one record per target, each in a file of the folder `targets`."""

import dataclasses
import difflib
import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.exports.cars import CarModel
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Job:
  """What is exported.

  Attributes:
    theta: the twin's parameters, (P,).
    dataset: its recordings, for what no twin holds (noise, rates) and to match numbers with; None without.
    command_shift: control periods by which commands act later than logged.
    options: of single targets, by name.
  """

  twin: Twin
  theta: Array
  dataset: DataSet | None = None
  command_shift: int = 0
  options: Mapping[str, str] = dataclasses.field(default_factory=dict)

  @property
  def present(self) -> tuple[Mechanism, ...]:
    """The twin's effects that are not at their null."""
    return tuple(m for m in self.twin.mechanisms if self.twin.present(m, self.theta[None]) is not None)

  def kept(self, target: "Target") -> tuple[Mechanism, ...]:
    """Effects of the car, not of its sensors, that a target expresses."""
    return tuple(m for m in self.present if m.stage != "sensor" and target.expresses(m))

  def plain(self, target: "Target", *names: str) -> Array:
    """The twin's parameters (P,) without what of its base a target lacks, or without what is named of that."""
    base, theta = self.twin.parameters, self.theta.copy()
    for name, values in target.structure.items():
      for parameter, value in values.items() if not names or name in names else ():
        if parameter in base.names:
          place = base.index(parameter)
          theta[place] = np.clip(value, base[parameter].lower, base[parameter].upper)
    return theta

  def lost(self, target: "Target") -> tuple[Mechanism, ...]:
    """Effects of the car that it does not."""
    return tuple(m for m in self.present if m.stage != "sensor" and not target.expresses(m))


@dataclasses.dataclass(frozen=True)
class Target:
  """A tool's format.

  Attributes:
    name: as it is asked for.  file: usual name of the file.  summary: one line.
    write: writes the file and says what a user should know, sentence by sentence.
    expresses: whether the format holds an effect of the car.
    drives: the model that the written file makes and its numbers; None for what is no car.
    structure: what of the twin's base has no place in it, by name: base parameters at which the twin lacks it, too.
    instead: the same where the target has physics of its own: what the twin is given in the place of its own, from the
      written file.
  """

  name: str
  file: str
  summary: str
  write: Callable[[Job, Path], Sequence[str]]
  expresses: Callable[[Mechanism], bool] = lambda mechanism: False
  drives: Callable[[Path, Job], tuple[CarModel, Mapping[str, object]]] | None = None
  structure: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)
  instead: Mapping[str, Callable[[Path], Mechanism]] = dataclasses.field(default_factory=dict)


def targets() -> dict[str, Target]:
  """Every target by name, found in the folder."""
  folder = importlib.import_module("calibration.exports.targets")
  files = [importlib.import_module(f"{folder.__name__}.{m.name}") for m in pkgutil.iter_modules(folder.__path__)]
  return {file.TARGET.name: file.TARGET for file in sorted(files, key=lambda f: f.TARGET.name)}


def target_named(name: str) -> Target:
  """One of them.

  Raises:
    KeyError: there is none, with the nearest.
  """
  known = targets()
  if name not in known:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    meant = f"did you mean {near[0]}?" if near else "there are"
    raise KeyError(f"no export to '{name}'; {meant} {'' if near else ', '.join(known)}".strip())
  return known[name]
