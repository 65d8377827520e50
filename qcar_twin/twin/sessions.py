"""Parameters that differ from session to session: a servo's trim, the charge of a pack, the floor.

A shifted parameter has one more parameter per session, named `parameter@session`, which is added to it in the
recordings of that session and is null elsewhere. The shifts need not have mean zero: a fit tells a shared number and
the mean of its shifts apart by their priors alone. So the mean car is the shared number with the mean of the shifts.
A recording of a session that nobody knows is driven with the mean car.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter, ParameterSet

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SessionShifts:
  """Which parameters are shifted, and which recording belongs to which session.

  Attributes:
    session_of: session of each recording, by its name.
    std: how far each shifted parameter wanders between sessions, a standard deviation in its unit.
  """

  session_of: Mapping[str, str]
  std: Mapping[str, float]

  @property
  def names(self) -> tuple[str, ...]:
    """Of the sessions, in alphabetical order."""
    return tuple(sorted(set(self.session_of.values())))

  def parameters(self, known: ParameterSet) -> list[Parameter]:
    """One per shifted parameter and session, null and nominal 0."""
    made = []
    for name, std in self.std.items():
      kept, reach = known[name], 4.0 * std
      made += [
        Parameter(f"{name}@{session}", 0.0, -reach, reach, kept.unit, f"{kept.symbol}@{session}", 0.0, std, std)
        for session in self.names
      ]
    return made

  def apply(self, theta: Array, recordings: Sequence[str], parameters: ParameterSet) -> Array:
    """Vectors (n * S, P), n times the S recordings in turn, with the shifts of each recording's session added.

    Without a known session, the mean of the shifts is added. `theta` is changed in place.
    """
    if not self.std:
      return theta
    session = [self.session_of.get(name) for name in recordings]
    rows = np.arange(len(theta)) % len(recordings)
    for name in self.std:
      at, kept = parameters.index(name), parameters[name]
      for known in self.names:
        here = np.array([s == known for s in session])[rows]
        theta[here, at] += theta[here, parameters.index(f"{name}@{known}")]
      strange = np.array([s is None for s in session])[rows]
      theta[strange, at] += theta[strange][:, self._shifts(name, parameters)].mean(axis=1)
      theta[:, at] = np.clip(theta[:, at], kept.lower, kept.upper)
    return theta

  def mean_car(self, theta: Array, parameters: ParameterSet) -> Array:
    """A vector (P,) whose shifts are departures from their mean, which stands in the shared numbers: every session is
    driven as before, and so is the mean car by whoever leaves the shifts out.
    """
    centred = theta.copy()
    for name in self.std:
      at, shifts, kept = parameters.index(name), self._shifts(name, parameters), parameters[name]
      centred[at] = np.clip(theta[at] + theta[shifts].mean(), kept.lower, kept.upper)
      centred[shifts] += theta[at] - centred[at]
    return centred

  def _shifts(self, name: str, parameters: ParameterSet) -> list[int]:
    """Where the shifts of a parameter stand."""
    return [parameters.index(f"{name}@{session}") for session in self.names]


ONE_SESSION = SessionShifts({}, {})
