"""The twin beside the car: blocks of driving in, alarms out."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.likelihood import spike_weights, weighting_from
from calibration.fitting.observations import CHANNELS, Observations, observe
from calibration.fitting.windows import Cut
from calibration.watch.effects import CHANGES, Change, known_to, ordinary, variants, watching
from calibration.watch.evidence import BLOCK, Detector, Null, null_of, sizes_of
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

_HORIZON = 1.0  # s, over which poses are differenced
_WARM_UP = 0.4  # s, unscored
_SUSPECT = 0.5  # of an alarm's evidence: of changes that have it, the one that explains most is named
_NORMAL = 1.4826  # standard deviation over the median of magnitudes, of a Gaussian
_MOVES = 1e-3  # of a channel's error: signatures below it are rounding


@dataclasses.dataclass(frozen=True)
class Block:
  """Two seconds of one recording.

  Attributes:
    start, end: s.  sizes, information: of each change, (K,): a and d.d of `evidence`.
    rows: the values of the block in the observations, (n,).
    impossible: no simulation goes on from what was measured at its beginning.
  """

  recording: str
  start: float
  end: float
  sizes: Array
  information: Array
  rows: NDArray[np.int64]
  impossible: bool = False


@dataclasses.dataclass(frozen=True)
class Alarm:
  """The twin no longer holds.

  Attributes:
    time: of the end of the block that told it, s.  since: when it began, s; -inf where that was before the log's clock
      began anew.
    change: what explains it; None where no car could move as the log says.
    size: of the change, in its own unit.  evidence: log of the e-detector.
  """

  time: float
  since: float
  change: Change | None
  size: float
  evidence: float

  @property
  def name(self) -> str | None:
    """Of the change, if one explains it."""
    return self.change.name if self.change else None

  @property
  def sentence(self) -> str:
    """For people; times as of the log."""
    another = "a sensor, a unit or a sign of this log is another, or the car is; check the log"
    if self.change is None:
      return f"at {clock(self.since)} the log has a motion that no simulation goes on from: {another}"
    least, most = self.change.possible
    if not least <= self.size <= most:
      return (
        f"since {clock(self.since)} the twin errs by more than {self.change.words} or another change of the car could"
        f" make it (seen at {clock(self.time)}): {another}"
      )
    shown = f"{self.change.words} {self.change.scale * self.size:+.0f} {self.change.unit}"
    seen = f"seen at {clock(self.time)}, e = 10^{self.evidence / np.log(10.0):.0f}"
    return f"since {clock(self.since)} the twin no longer holds: {shown} ({seen}); to be sure, drive it and diagnose"


def clock(time: float) -> str:
  """Time of a log: of day where it counts from 1970 (UTC), else minutes and seconds since its beginning; -inf is before
  that."""
  if time == -np.inf:
    return "before the log began anew"
  if time > 1e8:
    return f"{int(time) // 3600 % 24:02d}:{int(time) // 60 % 60:02d}:{int(time) % 60:02d} UTC"
  tenths = round(10.0 * time)
  return f"{tenths // 600:d}:{0.1 * (tenths % 600):04.1f} min"


class Watch:
  """Evidence on every change, kept from block to block.

  Args:
    twin, theta: the calibrated twin, (P,).
    reference: recordings that show how it errs while it holds: of the car it was fitted to, best with some that it was
      not fitted to.
    command_shift: control periods by which commands act later than logged.
  """

  def __init__(
    self, twin: Twin, theta: Array, reference: Sequence[Recording], command_shift: int = 0,
    changes: Sequence[Change] = CHANGES,
  ):  # fmt: skip
    self.twin, theta = watching(twin, theta)
    self.theta = theta
    self.changes = known_to(self.twin, changes)
    self.channels = frozenset().union(*(r.streams for r in reference))
    self._cut = Cut(length=BLOCK, warm_up=_WARM_UP, command_shift=command_shift)
    self._variants = variants(self.twin, theta, (*self.changes, *ordinary(self.twin)))
    observations, predicted = self._driven(reference)
    self._weighting = weighting_from(observations, observations.measured - predicted[0], {})
    blocks = list(self._blocks(observations, predicted))
    names = {name: k for k, name in enumerate(dict.fromkeys(b.recording for b in blocks))}
    recording = np.array([names[b.recording] for b in blocks])
    sizes, information = np.stack([b.sizes for b in blocks]), np.stack([b.information for b in blocks])
    self.nulls: list[tuple[Null, Null]] = [
      null_of(sizes[:, k], information[:, k], recording) for k in range(len(self.changes))
    ]
    watched = sum(1 + change.both for change in self.changes)
    self.detectors = [[Detector(null, watched) for null in pair] for pair in self.nulls]
    self._judged = -np.inf  # s, beginning of the last block

  def unwatched(self) -> list[str]:
    """Changes that nothing tells from what the twin errs anyway, a sentence each."""
    blind = [c.words for c, (null, _) in zip(self.changes, self.nulls, strict=True) if not null.watchable]
    return [f"not watched: {words}; on the data set the twin errs by as much" for words in blind]

  def _driven(self, recordings: Sequence[Recording]) -> tuple[Observations, Array]:
    """What was measured, and what the twin predicts, with each change, and with what is ordinary, (1 + K + B, M)."""
    observations = observe(recordings, self.twin.vehicle, self._cut, horizon=_HORIZON)
    return observations, observations.predict(self.twin.rollout(self._variants, observations.stretches.segments))

  def _scaled(self, observations: Observations, residual: Array) -> Array:
    """Factor on each value: over the size of its channel's error, neighbours as one witness, spikes less, (M,).

    A spike is one beside the rest of its block: an error that lasts is none, however large.
    """
    std, correlation = (part[observations.channel] for part in (self._weighting.std, self._weighting.correlation))
    size, usual = np.abs(residual), std.copy()
    _, group = np.unique(observations.stretch * len(CHANNELS) + observations.channel, return_inverse=True)
    for rows in np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1]):
      usual[rows] = np.maximum(usual[rows], _NORMAL * np.median(size[rows]))
    return np.nan_to_num(np.sqrt(spike_weights(size, usual) / correlation) / std)

  def _blocks(self, observations: Observations, predicted: Array) -> Iterator[Block]:
    """Blocks in the order of driving."""
    raw = observations.measured - predicted[0]
    over = self._scaled(observations, raw)
    residual = np.nan_to_num(raw * over, posinf=0.0, neginf=0.0)
    signature = np.nan_to_num((predicted[1:] - predicted[0]) * over, posinf=0.0, neginf=0.0)
    signature[np.abs(signature) < _MOVES] = 0.0
    segments, first, last = (getattr(observations.stretches, name) for name in ("segments", "first", "last"))
    stretch, count = observations.stretch, len(self.changes)
    for s, name in enumerate(segments.recording):
      rows = np.flatnonzero(stretch == s)
      sizes, information = sizes_of(residual[rows], signature[:count, rows], signature[count:, rows])
      impossible = not np.isfinite(predicted[0, rows]).all()
      yield Block(name, float(first[s]), float(last[s]), sizes, information, rows, impossible)

  def take(self, recording: Recording, scored_from: float = -np.inf) -> tuple[list[Alarm], Observations, Array]:
    """Judge a recording, or its latest piece; blocks that begin before `scored_from` [s] are left out.

    Returns:
      alarms, at most one per change and block; what was measured; what the twin predicts of it, (M,).
    """
    observations, predicted = self._driven([recording])
    alarms: list[Alarm] = []
    for block in self._blocks(observations, predicted):
      if block.start >= scored_from - 1e-9:
        alarms += self.judge(block)
    return alarms, observations, predicted[0]

  def blocks(self, recording: Recording) -> list[tuple[Block, frozenset[str]]]:
    """A recording's blocks, each with the names of the changes that it shows (see `Detector.shown_by`)."""
    made = []
    for block in self._blocks(*self._driven([recording])):
      shows = (c.name for c, pair, known in zip(self.changes, self.detectors, block.information, strict=True)
               if pair[0].shown_by(float(known)))  # fmt: skip
      made.append((block, frozenset(shows)))
    return made

  def reset(self) -> None:
    """Forget all evidence."""
    for pair in self.detectors:
      for detector in pair:
        detector.reset()

  def judge(self, block: Block) -> list[Alarm]:
    """Take one block's evidence in; the alarm that it completes, if any. One that begins before the last block did is
    of a log whose clock began anew."""
    if block.start < self._judged:
      for pair in self.detectors:
        for detector in pair:
          detector.begin_anew()
    self._judged = block.start
    if block.impossible:
      self.reset()
      return [Alarm(block.end, block.start, None, np.nan, np.inf)]
    told = False
    open_cases: list[tuple[float, Alarm]] = []
    for k, change in enumerate(self.changes):
      for sign, detector in zip((1.0, -1.0) if change.both else (1.0,), self.detectors[k], strict=False):
        told |= detector.take(block.start, sign * block.sizes[k], block.information[k])
        if detector.evidence >= _SUSPECT * detector.threshold:
          size = sign * detector.size * change.size
          alarm = Alarm(block.end, detector.since, change, size, detector.evidence)
          open_cases.append((detector.explained, alarm))
    if not told:
      return []
    self.reset()  # what was seen is said
    return [max(open_cases, key=lambda case: case[0])[1]]
