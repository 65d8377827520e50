"""Named physical parameters and the flat vectors a fit works on.

A `Parameter` is a declaration: name, unit, range, and how well a person knows it beforehand.
A `ParameterSet` is an ordered tuple of them with the maps between names and vectors.
"""

import dataclasses
import difflib
import functools
from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

PriorKind = Literal["measured", "class", "open"]


@dataclasses.dataclass(frozen=True)
class Parameter:
  """One physical parameter.

  Attributes:
    name: unique name in full words.
    nominal: value before any fit, in `unit`.
    lower, upper: hard bounds of a fit, in `unit`.
    unit: SI unit, "-" for none.
    symbol: letter used in equations and reports.
    null: value at which the physics it belongs to is absent; None if it has none.
    std: prior standard deviation in `unit`, of what was measured; None for a weak prior (a third of the range).
    factor: in place of `std`, of what is typical of the class: the prior is log-normal about `nominal`, and one
      standard deviation is this factor up or down; above 1.
    start: where a search begins, in `unit`, while the nominal value is the null: a limit that does not act yet has no
      slope there.
    assumed: nobody measured it on this car, so that `std`, too, is typical of the class.
    typical: a usual size, in `unit`: what a search and a scan try first. It decides no claim.
    description: one line for reports.
    step: move worth one step of a fit, in `unit`, where prior and typical size say nothing of it: about the width of
      the cost's minimum. Differences are taken over a few percent of it and long steps are held back in units of it.
  """

  name: str
  nominal: float
  lower: float
  upper: float
  unit: str
  symbol: str = ""
  null: float | None = None
  std: float | None = None
  typical: float | None = None
  description: str = ""
  step: float | None = None
  start: float | None = None
  factor: float | None = None
  assumed: bool = False

  def __post_init__(self) -> None:
    if not self.lower < self.upper:
      raise ValueError(f"parameter '{self.name}': its bounds [{self.lower:g}, {self.upper:g}] leave nothing to fit")
    if not self.lower <= self.nominal <= self.upper:
      raise ValueError(
        f"parameter '{self.name}': nominal {self.nominal:g} {self.unit} lies outside its bounds"
        f" [{self.lower:g}, {self.upper:g}]; widen the bounds or correct the nominal value"
      )
    if self.null is not None and not self.lower <= self.null <= self.upper:
      raise ValueError(f"parameter '{self.name}': null {self.null:g} lies outside its bounds")
    if self.factor is not None and (self.factor <= 1.0 or self.lower <= 0.0 or self.std is not None):
      raise ValueError(
        f"parameter '{self.name}': a log-normal prior needs a factor above 1, a lower bound above 0 and no std"
      )

  @property
  def kind(self) -> PriorKind:
    """How it is known beforehand: measured on this car, typical of its class, or open."""
    if self.factor is not None or self.assumed:
      return "class"
    return "open" if self.std is None else "measured"

  @property
  def prior(self) -> str:
    """The prior in one phrase."""
    if self.factor is not None:
      return f"{self.kind}, a factor of {self.factor:g}"
    return self.kind if self.std is None else f"{self.kind}, ±{self.std:.2g}"

  @property
  def scale(self) -> float:
    """A natural step: the one stated, else the prior's standard deviation, the typical size, the range / 10."""
    return self.step or self.std or self.typical or (self.upper - self.lower) / 10.0


class ParameterSet:
  """An ordered, immutable set of parameters: vector <-> names."""

  def __init__(self, parameters: Iterable[Parameter]):
    self._parameters = tuple(parameters)
    self._position = {p.name: i for i, p in enumerate(self._parameters)}
    if len(self._position) != len(self._parameters):
      names = [p.name for p in self._parameters]
      raise ValueError(f"parameter '{next(n for n in names if names.count(n) > 1)}' is declared twice")

  def __iter__(self) -> Iterator[Parameter]:
    return iter(self._parameters)

  def __len__(self) -> int:
    return len(self._parameters)

  def __getitem__(self, name: str) -> Parameter:
    return self._parameters[self.index(name)]

  def __contains__(self, name: str) -> bool:
    return name in self._position

  def __add__(self, other: Iterable[Parameter]) -> "ParameterSet":
    return ParameterSet((*self, *other))

  def __repr__(self) -> str:
    rows = [f"  {p.name} = {p.nominal:g} {p.unit} in [{p.lower:g}, {p.upper:g}]: {p.prior}" for p in self]
    return "ParameterSet(\n" + "\n".join(rows) + "\n)"

  @property
  def names(self) -> tuple[str, ...]:
    return tuple(self._position)

  @property
  def nominal(self) -> NDArray[np.float64]:
    """Nominal values, (P,)."""
    return np.array([p.nominal for p in self], dtype=np.float64)

  @property
  def start(self) -> NDArray[np.float64]:
    """Where a search begins, (P,), within the bounds."""
    begun = [p.start if p.start is not None and p.nominal == p.null else p.nominal for p in self]
    return np.clip(np.array(begun, dtype=np.float64), self.lower, self.upper)

  @property
  def lower(self) -> NDArray[np.float64]:
    return np.array([p.lower for p in self], dtype=np.float64)

  @property
  def upper(self) -> NDArray[np.float64]:
    return np.array([p.upper for p in self], dtype=np.float64)

  @property
  def std(self) -> NDArray[np.float64]:
    """Prior standard deviations at the nominal values, (P,); a third of the range where none is stated."""
    wide = lambda p: p.nominal * np.log(p.factor) if p.factor else (p.upper - p.lower) / 3.0
    return np.array([p.std or wide(p) for p in self], dtype=np.float64)

  def deviations(self, theta: ArrayLike) -> NDArray[np.float64]:
    """z, (P,), of one vector in prior standard deviations: minus its log prior is z'z / 2 up to a constant.

    (theta - nominal) / std, and log(theta / nominal) / log(factor) of what is typical of the class.
    """
    theta, wide = np.asarray(theta, dtype=np.float64), self._widths
    z = (theta - self.nominal) / self.std
    z[self._log] = np.log(theta[self._log] / self.nominal[self._log]) / wide
    return z

  def deviation_slopes(self, theta: ArrayLike) -> NDArray[np.float64]:
    """dz / dtheta, (P,); its square is the prior's precision."""
    theta, slopes = np.asarray(theta, dtype=np.float64), 1.0 / self.std
    slopes[self._log] = 1.0 / (theta[self._log] * self._widths)
    return slopes

  @functools.cached_property
  def _log(self) -> NDArray[np.int64]:
    return np.array([i for i, p in enumerate(self) if p.factor is not None], dtype=np.int64)

  @functools.cached_property
  def _widths(self) -> NDArray[np.float64]:
    return np.log([p.factor for p in self if p.factor is not None])

  @property
  def scale(self) -> NDArray[np.float64]:
    return np.array([p.scale for p in self], dtype=np.float64)

  def index(self, name: str) -> int:
    """Position of a parameter in the vector.

    Raises:
      KeyError: unknown name, with the nearest known ones.
    """
    if name not in self._position:
      near = difflib.get_close_matches(name, self.names, n=3) or list(self.names[:8])
      raise KeyError(f"no parameter '{name}'; did you mean {', '.join(near)}?")
    return self._position[name]

  def vector(self, values: Mapping[str, float] | None = None) -> NDArray[np.float64]:
    """Nominal vector with the named values put in, (P,)."""
    theta = self.nominal
    for name, value in (values or {}).items():
      theta[self.index(name)] = value
    return theta

  def named(self, theta: ArrayLike) -> dict[str, float]:
    """Names and values of one vector, (P,)."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.shape != (len(self),):
      raise ValueError(f"expected a vector of {len(self)} parameters, got shape {theta.shape}")
    return dict(zip(self.names, theta.tolist(), strict=True))

  def replace(self, **changes: Parameter) -> "ParameterSet":
    """The same set with some parameters re-declared (keyed by their present name)."""
    for name in changes:
      self.index(name)
    return ParameterSet(changes.get(p.name, p) for p in self)
