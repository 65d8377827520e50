"""Named physical parameters and the flat vectors a fit works on.

A `Parameter` is a declaration: name, unit, range, and how well a person knows it beforehand.
A `ParameterSet` is an ordered tuple of them with the maps between names and vectors.
"""

import dataclasses
import difflib
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray


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
    std: prior standard deviation in `unit`; None for a weak prior (a third of the range).
    typical: size worth talking about, in `unit`; materiality is judged against it.
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

  def __post_init__(self) -> None:
    if not self.lower <= self.nominal <= self.upper:
      raise ValueError(
        f"parameter '{self.name}': nominal {self.nominal:g} {self.unit} lies outside its bounds"
        f" [{self.lower:g}, {self.upper:g}]; widen the bounds or correct the nominal value"
      )
    if self.null is not None and not self.lower <= self.null <= self.upper:
      raise ValueError(f"parameter '{self.name}': null {self.null:g} lies outside its bounds")

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
    rows = [f"  {p.name} = {p.nominal:g} {p.unit} in [{p.lower:g}, {p.upper:g}]" for p in self]
    return "ParameterSet(\n" + "\n".join(rows) + "\n)"

  @property
  def names(self) -> tuple[str, ...]:
    return tuple(self._position)

  @property
  def nominal(self) -> NDArray[np.float64]:
    """Nominal values, (P,)."""
    return np.array([p.nominal for p in self], dtype=np.float64)

  @property
  def lower(self) -> NDArray[np.float64]:
    return np.array([p.lower for p in self], dtype=np.float64)

  @property
  def upper(self) -> NDArray[np.float64]:
    return np.array([p.upper for p in self], dtype=np.float64)

  @property
  def std(self) -> NDArray[np.float64]:
    """Prior standard deviations, (P,); a third of the range where none is stated."""
    return np.array([p.std or (p.upper - p.lower) / 3.0 for p in self], dtype=np.float64)

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
