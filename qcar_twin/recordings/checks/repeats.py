"""The same driving twice: stretches that two recordings share sample by sample, as copied files and cut logs do."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import Recording, RecordingError

_WINDOW = 25  # samples that must be equal in a row; noise does not repeat so many by chance
_CHANGES = _WINDOW // 2  # of value within them: a car at rest repeats itself
_FALLBACK = ("pose_x", "pose_y", "motor_speed", "speed")  # where no channel is noisy, in this order


@dataclass(frozen=True)
class Repeat:
  """A stretch of `first` from `start` to `end`, s, which `second` holds from `at`, s, on; `channel` shows it."""

  first: Recording
  second: Recording
  channel: str
  start: float
  end: float
  at: float

  def __str__(self) -> str:
    first, second = self.first, self.second
    return (
      f"{second.file or second.name} (role {second.role}) repeats {first.file or first.name} (role {first.role}): "
      f"{self.channel} is the same sample by sample from {self.start:g} s to {self.end:g} s there and from "
      f"{self.at:g} s on here"
    )


def refuse_repeats(recordings: Sequence[Recording]) -> list[str]:
  """Notes about stretches that occur twice.

  Raises:
    RecordingError: a hold-out recording repeats one that is not: what it would judge was fitted to it.
  """
  notes = []
  for repeat in find_repeats(recordings):
    if (repeat.first.role == "holdout") != (repeat.second.role == "holdout"):
      raise RecordingError(
        f"{repeat}; a hold-out that was seen before judges nothing: give both one role, or leave the stretch out of "
        "one of them with from and to"
      )
    notes.append(f"{repeat}; it counts twice")
  return notes


def find_repeats(recordings: Sequence[Recording]) -> list[Repeat]:
  """The longest stretch that each pair of recordings shares, in their order; none for pairs that share nothing."""
  longest: dict[tuple[int, int], Repeat] = {}
  for channel in _telling(recordings):
    holders = [i for i, r in enumerate(recordings) if channel in r and len(r[channel]) >= _WINDOW]
    if len(holders) < 2:
      continue
    for a, b, start, at, count in _shared([recordings[i][channel].value for i in holders]):
      pair = (holders[a], holders[b])
      first, second = recordings[pair[0]], recordings[pair[1]]
      time, samples = first[channel].time, count + _WINDOW - 1
      repeat = Repeat(first, second, channel, time[start], time[start + samples - 1], second[channel].time[at])
      if pair not in longest or repeat.end - repeat.start > longest[pair].end - longest[pair].start:
        longest[pair] = repeat
  return [longest[pair] for pair in sorted(longest)]


def _telling(recordings: Sequence[Recording]) -> list[str]:
  """Channels whose samples don't repeat by themselves."""
  present = set(itertools.chain.from_iterable(r.channels for r in recordings))
  noisy = [name for name in CHANNELS if name in present and CHANNELS[name].noisy]
  return noisy or [name for name in _FALLBACK if name in present][:1]


def _shared(values: Sequence[np.ndarray]) -> list[tuple[int, int, int, int, int]]:
  """Runs of equal windows in two of several arrays: (array, other array, place, place there, windows)."""
  keys, owners, places = [], [], []
  for owner, value in enumerate(values):
    key, place = _keys(value)
    keys.append(key)
    owners.append(np.full(len(key), owner))
    places.append(place)
  key, owner, place = (np.concatenate(parts) for parts in (keys, owners, places))
  order = np.lexsort((place, owner, key))
  key, owner, place = key[order], owner[order], place[order]
  same = np.flatnonzero((key[1:] == key[:-1]) & (owner[1:] != owner[:-1]))
  starts_of: dict[tuple[int, int, int], list[int]] = {}
  for i in same:
    a, b, start, at = int(owner[i]), int(owner[i + 1]), int(place[i]), int(place[i + 1])
    if np.array_equal(values[a][start : start + _WINDOW], values[b][at : at + _WINDOW]):
      starts_of.setdefault((a, b, at - start), []).append(start)
  runs = []
  for (a, b, apart), starts in starts_of.items():
    for run in np.split(np.sort(starts), np.flatnonzero(np.diff(np.sort(starts)) > 1) + 1):
      runs.append((a, b, int(run[0]), int(run[0]) + apart, len(run)))
  return runs


def _keys(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """A hash of every window of values that changes often enough, and where it begins."""
  count = len(value) - _WINDOW + 1
  bits = np.ascontiguousarray(value, dtype=np.float64).view(np.uint64)
  weights = np.random.default_rng(0).integers(1, 2**63, _WINDOW, dtype=np.uint64) | np.uint64(1)
  key = np.zeros(count, dtype=np.uint64)
  for k, weight in enumerate(weights):
    key += weight * bits[k : k + count]
  changes = np.r_[0, np.cumsum(np.diff(value) != 0.0)]
  place = np.flatnonzero(changes[_WINDOW - 1 :] - changes[:count] >= _CHANGES)
  return key[place], place
