"""Everything a decision rests on, as plain numbers: `evidence.json`.

A search gathers it (`calibration.diagnosis.search.gather`); `decide` and `conclude` read nothing else. So a rule can be
tried on every case whose evidence was kept, in milliseconds and without a simulator.
"""

import dataclasses
import json
import math
import os
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.structure import Leftover
from qcar_twin.atomic_io import plain, write_json
from qcar_twin.untrusted import UnreadableFile, read_json

FILE = "evidence.json"
DIGITS = ".6g"  # of every number in it
_NOT_READ = {"size", "typical", "added", "profile", "prior_cost"}  # what earlier files also have; nothing depends on it


@dataclasses.dataclass(frozen=True)
class Estimate:
  """A fitted parameter of a mechanism.

  Attributes:
    name, unit: as declared.
    value, std: with a deviation from the scatter of recordings.
    null: value at which the mechanism does nothing; None of a parameter that only shapes it.
  """

  name: str
  value: float
  std: float
  unit: str
  null: float | None


@dataclasses.dataclass(frozen=True)
class Taken:
  """Share that a name takes off the held-out error of a channel, negative where it grows, and Student's t of it."""

  channel: str
  share: float
  t: float


@dataclasses.dataclass(frozen=True)
class Alternative:
  """What was fitted in a name's place.

  Attributes:
    name: of the mechanism.
    nats: that it brings there, priors included.
    t: held-out gain over its standard error there, with what the priors gain.
    at_bound: whether its amplitude went as far as it may.
    behind_t: held-out t of the name over it.
    behind_priors: nats of the priors by which it is behind the name.
    beside: nats that the name brings where both are in the model; 0 where that was not fitted.
  """

  name: str
  nats: float
  t: float
  at_bound: bool
  behind_t: float
  behind_priors: float
  beside: float = 0.0


@dataclasses.dataclass(frozen=True)
class Measured:
  """A figure of the car that somebody measured, or the age of a sensor's readings, and what the driving asks for.

  Attributes:
    name, unit: as declared.
    measured, std: with the deviation that was stated; of an age, what is usual.
    value: fitted.
    size: of which errors are shares: of the figure; the control period of a time; of a figure that is a distance from
      what was measured, the size of that.
    usual: nobody measured it, and `measured` and `std` are those of all such sensors.
  """

  name: str
  measured: float
  std: float
  value: float
  size: float
  unit: str
  usual: bool = False


@dataclasses.dataclass(frozen=True)
class Named:
  """A name in a model, against the model without it.

  Attributes:
    name: id of the mechanism.
    held_out: the two compared on groups left out; its drop has the priors.
    at_bound: whether an amplitude went as far as it may.
    errors: what it takes off each channel.
    estimates: of its parameters.
    alternatives: fitted in its place.
    scores: slope of the fit along the change that it makes, over the change's norm, in each second.
    deviations: of a sensor's own error, amplitudes in deviations of what every such sensor has; () of all else.
    without: figures of the car that were measured, as the model without the name has them; () of a sensor's own error.
  """

  name: str
  held_out: Comparison
  at_bound: bool
  errors: tuple[Taken, ...]
  estimates: tuple[Estimate, ...]
  alternatives: tuple[Alternative, ...] = ()
  scores: tuple[float, ...] = ()
  deviations: tuple[float, ...] = ()
  without: tuple[Measured, ...] = ()

  @property
  def t(self) -> float:
    """Held-out gain over its standard error, with what the priors gain: there absorbed effects show."""
    return self.held_out.t_with_priors

  @property
  def best_first(self) -> tuple[Alternative, ...]:
    """The alternatives by their nats."""
    return tuple(sorted(self.alternatives, key=lambda a: (-a.nats, a.name)))

  def margin(self, leaving_out: tuple[str, ...] = ()) -> float:
    """Nats ahead of the best alternative but for some, or of nothing.

    What explains something else is no alternative, however many nats: one counts by the share of the name's nats that
    it takes over, that is, by what the name does not bring beside it.
    """
    drop, rivals = self.held_out.drop, [a for a in self.alternatives if a.name not in leaving_out]
    taken = lambda a: 1.0 - min(a.beside / drop, 1.0) if drop > 0.0 else 1.0
    return min([drop, *(drop - a.nats * taken(a) for a in rivals)])


@dataclasses.dataclass(frozen=True)
class Against:
  """A model against a smaller one that it does not hold: held-out t with the priors, and nats ahead."""

  mechanisms: tuple[str, ...]
  t: float
  drop: float


@dataclasses.dataclass(frozen=True)
class Model:
  """A set of mechanisms that was fitted.

  Attributes:
    mechanisms: in it, sorted; () for the recalibrated twin.
    drop: nats by which it fits better than the recalibrated twin.
    names: each of its mechanisms weighed.
    sensors: sensors' own errors, which every model has, weighed alike.
    against: smaller models that it does not hold.
    measured: figures of the car that were measured.
  """

  mechanisms: tuple[str, ...]
  drop: float
  names: tuple[Named, ...] = ()
  sensors: tuple[Named, ...] = ()
  against: tuple[Against, ...] = ()
  measured: tuple[Measured, ...] = ()


@dataclasses.dataclass(frozen=True)
class Scanned:
  """A mechanism as the scan saw it from the recalibrated twin.

  Attributes:
    name: id of the mechanism.
    gain: nats that its signature explains, priors included; None where it was not scanned.
    refitted: nats that it brings alone; None where it was not refitted.
    scores: slope of the fit along its signature in each second of driving, over the signature's norm; half the square
      of their sum is what the driving has of the gain.
  """

  name: str
  gain: float | None
  refitted: float | None
  scores: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True)
class Remaining:
  """Structure in the residuals of a model."""

  mechanisms: tuple[str, ...]
  items: tuple[Leftover, ...]


@dataclasses.dataclass(frozen=True)
class HeldOutError:
  """Root mean square error of a channel on recordings that took no part, in its unit.

  Attributes:
    role: "validate" or "holdout".
    before, after: of the recalibrated twin and of the model behind the claims.
    ci95: bounds of after / before - 1 by blocks.
    noise: what the sensor itself makes.
  """

  role: str
  channel: str
  before: float
  after: float
  ci95: tuple[float, float]
  noise: float
  unit: str
  samples: int


@dataclasses.dataclass(frozen=True)
class HeldOutRatio:
  """Error on held-out recordings with a name of a model over that without it, geometric mean over the channels."""

  name: str
  ratio: float


@dataclasses.dataclass(frozen=True)
class Opened:
  """A model that held-out recordings were opened for, with what each of its names does to their errors."""

  mechanisms: tuple[str, ...]
  ratios: tuple[HeldOutRatio, ...]


@dataclasses.dataclass(frozen=True)
class Evidence:
  """What is known of a data set when its models are fitted.

  Attributes:
    dataset: its name.
    models: the recalibrated twin and the sets that fit best of each size.
    scanned: every mechanism.
    remaining: structure left by the models that were looked at.
    errors: hold-out errors, once those recordings were opened.
    opened: models that held-out recordings were opened for.
  """

  dataset: str
  models: tuple[Model, ...]
  scanned: tuple[Scanned, ...]
  remaining: tuple[Remaining, ...] = ()
  errors: tuple[HeldOutError, ...] = ()
  opened: tuple[Opened, ...] = ()

  @property
  def base(self) -> Model:
    """The recalibrated twin."""
    return next(m for m in self.models if not m.mechanisms)

  def of_size(self, size: int) -> list[Model]:
    """Sets of a size, best first."""
    return sorted((m for m in self.models if len(m.mechanisms) == size), key=lambda m: (-m.drop, m.mechanisms))

  def left(self, mechanisms: tuple[str, ...]) -> tuple[Leftover, ...] | None:
    """Structure that a model leaves; None where it was not looked at."""
    return next((r.items for r in self.remaining if r.mechanisms == mechanisms), None)

  def with_left(self, mechanisms: tuple[str, ...], items: Iterable[Leftover]) -> "Evidence":
    """The same with what a model leaves."""
    return dataclasses.replace(self, remaining=(*self.remaining, rounded(Remaining(mechanisms, tuple(items)))))

  def is_open(self, mechanisms: tuple[str, ...]) -> bool:
    """Whether held-out recordings were opened for a model."""
    return any(o.mechanisms == mechanisms for o in self.opened)

  def held_out_ratio(self, mechanisms: tuple[str, ...], name: str) -> float | None:
    """Error with a name of a model over that without it, on held-out recordings; None where they were not opened."""
    return next((r.ratio for o in self.opened if o.mechanisms == mechanisms for r in o.ratios if r.name == name), None)

  def with_opened(self, mechanisms: tuple[str, ...], ratios: Mapping[str, float]) -> "Evidence":
    """The same with what a model's names do to the errors on held-out recordings."""
    opened = Opened(mechanisms, tuple(HeldOutRatio(name, ratio) for name, ratio in ratios.items()))
    return dataclasses.replace(self, opened=(*self.opened, rounded(opened)))


def rounded(value: Any) -> Any:
  """Evidence, or a part of it, with numbers as its file has them, so that a replay decides on the very same."""
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    parts = ((f.name, rounded(getattr(value, f.name))) for f in dataclasses.fields(value))
    return dataclasses.replace(value, **dict(parts))
  if isinstance(value, tuple):
    return tuple(map(rounded, value))
  return float(f"{value:{DIGITS}}") if isinstance(value, float) else value


def write_evidence(folder: str | os.PathLike[str], evidence: Evidence) -> Path:
  """Write evidence.json; returns its path."""
  return write_json(Path(folder) / FILE, as_json(evidence))


def read_evidence(file: str | os.PathLike[str]) -> Evidence:
  """The evidence of a file.

  Raises:
    UnreadableFile: it is no evidence; says where.
  """
  return from_json(read_json(Path(file)), str(file))


def as_json(evidence: Evidence) -> dict[str, Any]:
  """The same as plain Python types; a number that is not finite becomes null."""
  return plain(dataclasses.asdict(evidence))


def from_json(content: Mapping[str, Any], where: str = FILE) -> Evidence:
  """Evidence from what `as_json` made; where: what an error names."""
  try:
    return _read(Evidence, json.loads(json.dumps(content)))
  except (TypeError, ValueError, KeyError) as error:
    raise UnreadableFile(f"{where}: is no evidence of a diagnosis ({error}); diagnose the data set again") from error


def _read(kind: Any, value: Any) -> Any:
  """A value of an annotated type: a dataclass, a tuple, a number, text."""
  if dataclasses.is_dataclass(kind):
    hints = typing.get_type_hints(kind)
    if unknown := set(value) - set(hints) - _NOT_READ:
      raise ValueError(f"nothing in it is called {', '.join(sorted(unknown))}")
    return kind(**{name: _read(hints[name], item) for name, item in value.items() if name in hints})  # type: ignore[operator]
  origin, inner = typing.get_origin(kind), typing.get_args(kind)
  if origin is types.UnionType:  # a number or None
    return None if value is None else _read(inner[0], value)
  if origin is tuple:
    kinds = [inner[0]] * len(value) if inner[-1] is Ellipsis else inner
    return tuple(_read(k, v) for k, v in zip(kinds, value, strict=True))
  if kind is float:
    return math.nan if value is None else float(value)
  if not isinstance(value, kind):
    raise ValueError(f"{value!r} is no {kind.__name__}")
  return value
