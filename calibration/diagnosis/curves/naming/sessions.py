"""What sessions share and what they differ in.

A number that every session shares and a shift of it for each are told apart by the shifts' prior alone: as much as all
shifts have in common may stand in either. What the data tell are contrasts: the shared number with the mean of the
shifts, and each session's departure from that mean. Each is a direction among the parameters, with a deviation of its
own that is many times smaller than those of the numbers it is made of.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def contrasts(names: Sequence[str]) -> dict[str, Array]:
  """By parameter that sessions have shifts of, and by shift, the weights of its contrast over all parameters, (p,).

  Args:
    names: of the fitted parameters, shifts as `parameter@session`; what is shared need not be among them.
  """
  shifts: dict[str, list[int]] = {}
  for at, name in enumerate(names):
    if "@" in name:
      shifts.setdefault(name.split("@")[0], []).append(at)
  made = {}
  for kind, listed in shifts.items():
    mean = np.zeros(len(names))
    mean[listed] = 1.0 / len(listed)
    if kind in names:
      made[kind] = mean.copy()
      made[kind][list(names).index(kind)] += 1.0
    for at in listed:
      made[names[at]] = -mean
      made[names[at]][at] += 1.0
  return made
