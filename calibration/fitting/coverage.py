"""Whether the fitted recordings go everywhere the judging ones go, and what to do where they don't.

An error of the steering to the right can't be learnt from turns to the left. A recording that only judges and
goes where no fitted one goes can veto a name and can't find one: it is fitted, too, and the hold-out runs judge.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS, COMMANDS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

_OUTSIDE = 0.1  # share of the judging drives that may lie outside
_EDGE = 1.0  # per cent of the fitted driving that is left out at either end of its range
_WIDER = 0.1  # of the range, by which it is widened: so far a fit is trusted beyond what it saw
_DRIVEN = 0.1  # of the largest voltage, below which the car is taken to stand or to coast
_PERIOD = 0.01  # s


def with_coverage(dataset: DataSet) -> tuple[DataSet, tuple[str, ...]]:
  """Give recordings that go far outside what is fitted the role "identify", farthest first, until few are left outside.

  Asked is what the car was commanded while it was driven: motor voltage and steering angle, sign and all.
  Nothing is changed where no hold-out recording would be left to judge.

  Args:
    dataset: recordings with roles.

  Returns:
    the data set with the roles to be used, and a sentence per recording whose role was changed.
  """
  recordings, notes = list(dataset.recordings), []
  if not dataset.role("holdout") or not dataset.role("identify"):
    return dataset, ()
  driven = _driven(recordings)
  while True:
    ranges = _ranges([d for r, d in zip(recordings, driven, strict=True) if r.role == "identify"])
    judging = [i for i, r in enumerate(recordings) if r.role == "validate" and len(driven[i])]
    beyond = {i: _beyond(driven[i], ranges) for i in judging}
    outside = {i: int(b.any(axis=1).sum()) for i, b in beyond.items()}
    if ranges is None or sum(outside.values()) <= _OUTSIDE * sum(len(driven[i]) for i in judging):
      break
    i = max(judging, key=outside.__getitem__)
    notes.append(_sentence(recordings[i].name, beyond[i], ranges))
    recordings[i] = recordings[i].replace(role="identify")
  return dataclasses.replace(dataset, recordings=tuple(recordings)), tuple(notes)


def _driven(recordings: Sequence[Recording]) -> list[Array]:
  """Commands of each recording while the motor is powered, (k, 2)."""
  commands = [r.commands(_PERIOD)[1] for r in recordings]
  least = _DRIVEN * max(float(np.abs(c[:, 0]).max(initial=0.0)) for c in commands)
  return [c[np.abs(c[:, 0]) > least] for c in commands]


def _ranges(driven: Sequence[Array]) -> Array | None:
  """Lower and upper end of what was commanded, (2, 2); None where nothing was driven."""
  together = np.concatenate(driven)
  if not len(together):
    return None
  low, high = np.percentile(together, [_EDGE, 100.0 - _EDGE], axis=0)
  room = _WIDER * (high - low)
  return np.stack([low - room, high + room])


def _beyond(driven: Array, ranges: Array | None) -> NDArray[np.bool_]:
  """Which samples lie outside, by command, (k, 2)."""
  return np.zeros(driven.shape, bool) if ranges is None else (driven < ranges[0]) | (driven > ranges[1])


def _sentence(name: str, beyond: NDArray[np.bool_], ranges: Array) -> str:
  k = int(np.argmax(beyond.sum(axis=0)))
  channel, share = COMMANDS[k], 100.0 * float(np.mean(beyond[:, k]))
  return (
    f"{name} was fitted although its role is validate: {share:.0f} % of its driving has {channel} outside"
    f" {ranges[0, k]:.3g} to {ranges[1, k]:.3g} {CHANNELS[channel].unit}, and no recording with the role identify "
    "goes there."
    " The hold-out recordings judge what came of it."
  )
