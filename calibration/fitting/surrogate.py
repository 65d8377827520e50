"""A twin to search with: the reduced car, put right by MuJoCo at one place.

  signals(theta) = reduced(theta) + MuJoCo(anchor) - reduced(anchor)

so at its anchor it is MuJoCo's own answer, and away from there it errs by how much the two cars' slopes differ. (The
additive correction of surrogate optimisation: Alexandrov and Lewis, An overview of first-order model management for
engineering optimization, Optimization and Engineering 2, 2001.) Sensors err after the correction.
"""

import copy
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import Segments
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.engines.reduced.cars import irreducible
from qcar_twin.twin.reading import in_pieces
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
Stretch = tuple[str, float]  # a recording's name, and where the stretch begins in it, s


class Surrogate(Twin):
  """The reduced car in place of a MuJoCo twin.

  Args:
    exact: the twin it stands in for.
    anchor: parameters at which it is MuJoCo's, (P,); None for the reduced car as it is.
    guarded: stretches that MuJoCo simulates whatever the parameters, since the two differ too much there.

  Raises:
    ValueError: the reduced car lacks something that this car has.
  """

  def __init__(self, exact: Twin, anchor: Array | None = None, guarded: Collection[Stretch] = ()):
    super().__init__(
      exact.vehicle,
      exact.mechanisms,
      exact.tyre,
      exact.asked_substeps,
      exact.threads,
      exact.rows,
      engine="reduced",
      sessions=exact.sessions,
    )
    self.exact, self.anchor, self.guarded = exact, anchor, frozenset(guarded)
    self._forget()

  def _forget(self) -> None:
    self._corrections: dict[tuple[str, float, int], Array] = {}
    self._latest: tuple[Segments, Array] | None = None  # corrections of the segments asked for last

  def at(self, anchor: Array) -> "Surrogate":
    """The same, put right at other parameters, (P,)."""
    made = copy.copy(self)
    made.anchor = np.array(anchor)
    made._forget()
    return made

  def guarding(self, stretches: Collection[Stretch]) -> "Surrogate":
    """The same with these stretches left to MuJoCo."""
    made = copy.copy(self)
    made.guarded = self.guarded | set(stretches)
    return made

  def apart(self) -> "Surrogate":
    made = super().apart()
    made.exact = self.exact.apart()
    return made

  def prepare(self, segments: Segments) -> None:
    """Simulate by MuJoCo what any parameters need on these segments."""
    if self.anchor is not None:
      free = np.flatnonzero(~self.left(segments))
      if len(free):
        self._correction(segments[free])

  def left(self, segments: Segments) -> NDArray[np.bool_]:
    """Segments that are left to MuJoCo."""
    which = zip(segments.recording, segments.offset.tolist(), strict=True)
    return np.array([stretch in self.guarded for stretch in which], dtype=bool)

  def simulate(self, theta: Array, segments: Segments) -> Array:
    left = self.left(segments)
    if not left.any():
      return self._corrected(theta, segments)
    signals = np.empty((len(theta), len(segments), segments.commands.shape[1] + 1, 10))
    if not left.all():
      signals[:, ~left] = self._corrected(theta, segments[np.flatnonzero(~left)])
    signals[:, left] = self.exact.simulate(theta, segments[np.flatnonzero(left)])
    return signals

  def _corrected(self, theta: Array, segments: Segments) -> Array:
    """Signals of the reduced car, put right at the anchor."""
    signals = super().simulate(theta, segments)
    if self.anchor is not None:
      signals += self._correction(segments)
    return signals

  def _correction(self, segments: Segments) -> Array:
    """MuJoCo minus reduced at the anchor, (S, T + 1, 10); simulated once per segment."""
    if self._latest is not None and self._latest[0] is segments:
      return self._latest[1]
    keys = [
      (name, float(offset), hash(commands.tobytes()))
      for name, offset, commands in zip(segments.recording, segments.offset, segments.commands, strict=True)
    ]
    unknown = np.array([i for i, key in enumerate(keys) if key not in self._corrections], dtype=int)
    if len(unknown):
      assert self.anchor is not None
      some, theta = segments[unknown], self.anchor[None]
      for i, change in zip(
        unknown, self.exact.simulate(theta, some)[0] - super().simulate(theta, some)[0], strict=True
      ):
        self._corrections[keys[i]] = np.nan_to_num(change, posinf=0.0, neginf=0.0)
    self._latest = segments, in_pieces(np.stack([self._corrections[key] for key in keys]))
    return self._latest[1]


def searching(twin: Twin, engine: EngineKind = "reduced") -> tuple[Twin, tuple[str, ...]]:
  """What to search with in place of a twin, and what there is to say about it.

  Args:
    twin: in MuJoCo.
    engine: "mujoco" for the twin itself; it is also taken where the reduced car can't stand in.
  """
  if engine == "mujoco":
    return twin, ()
  lacking = irreducible(twin.vehicle, twin.tyre)
  if lacking:
    return twin, (f"searched on MuJoCo alone, many times as long: the reduced car can't stand in, {lacking}",)
  return Surrogate(twin), ()


def exact(twin: Twin) -> Twin:
  """The MuJoCo twin behind what is searched with."""
  return twin.exact if isinstance(twin, Surrogate) else twin


def anchored(twin: Twin, names: Sequence[str], values: Array) -> Twin:
  """What is searched with, put right at estimates of some parameters, the others nominal."""
  if not isinstance(twin, Surrogate):
    return twin
  theta = twin.parameters.nominal
  theta[[twin.parameters.index(name) for name in names]] = values
  return twin.at(theta)
