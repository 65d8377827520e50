"""How channels are sampled: rate, jitter, values held by a slow publisher, the finest step."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, channels_of
from qcar_twin.recordings.checks.faults import Runs
from qcar_twin.recordings.recording import Recording, Stream


@dataclasses.dataclass(frozen=True)
class Sampling:
  """Of one channel over all recordings that hold it.

  Attributes:
    rate: samples per second.  jitter: interquartile range of the intervals over their median.
    longest: interval between samples, s.
    held: samples for which one value stays while the channel changes, median; 1 where every sample is new.
    quantum: the smallest step between values.
    values: different ones.
    seconds: recorded.
  """

  channel: str
  rate: float
  jitter: float
  longest: float
  held: float
  quantum: float
  values: int
  seconds: float

  @property
  def publishes(self) -> float:
    """New values per second."""
    return self.rate / self.held


def samplings(recordings: Sequence[Recording]) -> list[Sampling]:
  """Of every channel that occurs but the clock, in canonical order."""
  named = (name for kind in ("command", "sensor") for name in channels_of(kind))
  return [_sampling(name, streams) for name in named if (streams := [r[name] for r in recordings if name in r])]


def _sampling(channel: str, streams: Sequence[Stream]) -> Sampling:
  steps = np.concatenate([np.diff(s.time) for s in streams]) if any(len(s) > 1 for s in streams) else np.array([np.nan])
  low, usual, high = np.percentile(steps, [25, 50, 75])
  moves = np.abs(np.concatenate([np.diff(s.value) for s in streams]))
  return Sampling(
    channel=channel,
    rate=float(1.0 / usual),
    jitter=float((high - low) / usual),
    longest=float(steps.max()),
    held=1.0 if CHANNELS[channel].is_command else _held(streams),
    quantum=float(np.min(moves[moves > 1e-12], initial=np.inf)),
    values=len(np.unique(np.concatenate([s.value for s in streams]))),
    seconds=float(sum(s.time[-1] - s.time[0] for s in streams)),
  )


def _held(streams: Sequence[Stream]) -> float:
  """Median length of the runs of one value, without the long ones (rest, a stuck sensor)."""
  lengths = np.concatenate([Runs.of(s.value).length[1:-1] for s in streams])
  return float(np.median(lengths)) if len(lengths) else 1.0
