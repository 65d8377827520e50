"""What a watch writes: a line of NDJSON a block, and all of it as MCAP at the end."""

import itertools
import json
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import UNITS, Observations
from calibration.watch.evidence import BLOCK
from calibration.watch.follow import Tail, pieces
from calibration.watch.watch import Alarm, Watch, clock
from qcar_twin.atomic_io import plain
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.manifest import Manifest
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]
SOURCES = ("measured", "predicted", "difference")
Streams = dict[str, dict[str, list[Array]]]  # by source or "time", and channel


class Record:
  """Streams of measured, predicted and measured minus predicted values, channel by channel.

  Args:
    file: takes the lines.
    kept: whether streams stay in memory for `mcap`.

  Attributes:
    blocks: written so far.
    notes: what of the log is not watched, or stands still, a sentence each; said once.
  """

  def __init__(self, file: TextIO, kept: bool):
    self._file, self._kept = file, kept
    self.blocks = 0
    self.notes: dict[str, str] = {}
    self._since = -np.inf  # s, beginning of the last block
    self._drives = [_streams()]  # one for each time that the log's clock began anew

  def block(
    self, observations: Observations, predicted: Array, since: float, watch: Watch, alarms: list[Alarm]
  ) -> None:
    """Write what is new: values from `since` on [s], evidence on each change, alarms."""
    channels: dict[str, Any] = {}
    if since < self._since:
      self._drives.append(_streams())
    self._since = since
    for name in observations.present:
      rows = observations.select(name) & (observations.time >= since)
      values = (observations.time[rows], observations.measured[rows], predicted[rows])
      columns = dict(zip(("time", *SOURCES), (*values, values[1] - values[2]), strict=True))
      channels[name] = {"unit": UNITS[name], **columns}
      for source, column in columns.items() if self._kept else ():
        self._drives[-1][source].setdefault(name, []).append(column)
    evidence = {
      change.name: [round(float(max(d.evidence, -99.0)), 2) for d in pair]
      for change, pair in zip(watch.changes, watch.detectors, strict=True)
    }
    said = [{"since": a.since, "time": a.time, "change": a.name, "size": a.size, "text": a.sentence} for a in alarms]
    line = {"from": since, "channels": channels, "log_evidence": evidence, "alarms": said}
    self._file.write(json.dumps(plain(line), allow_nan=False) + "\n")
    self._file.flush()
    self.blocks += 1

  def mcap(self, path: Path) -> list[Path]:
    """All of it for Foxglove, PlotJuggler and Rerun, topics `/measured/yaw_rate` and so on: a file for each time that
    the log's clock began anew, the later ones named `watch_2.mcap` and so on."""
    named = (path.with_stem(f"{path.stem}_{k}") if k > 1 else path for k in itertools.count(1))
    return [_write(file, drive) for file, drive in zip(named, self._drives, strict=False)]


def _streams() -> Streams:
  return {source: {} for source in ("time", *SOURCES)}


def _write(path: Path, drive: Streams) -> Path:
  from qcar_twin.recordings.mcap_writer import write_mcap

  sources: dict[str, dict[str, Stream]] = {}
  for source in SOURCES:
    channels = {}
    for name, parts in drive[source].items():
      time, first = np.unique(np.concatenate(drive["time"][name]), return_index=True)
      value = np.concatenate(parts)[first]
      finite = np.isfinite(value)  # a log in another unit may begin where no simulation can go on
      channels[name] = Stream(time[finite], value[finite])
    sources["error_twin" if source == "difference" else source] = channels
  return write_mcap(path, sources, {"what": "a watch"}, dict(UNITS))


def _moves(piece: Recording) -> bool:
  return any(name in piece.streams and np.ptp(piece[name].value) > 0.0 for name in ("motor_speed", "speed", "pose_x"))


def look(watch: Watch, tail: Tail, manifest: Manifest, name: str, record: Record) -> list[Alarm]:
  """Judge and write down what is new in a log; the alarms in it."""
  alarms: list[Alarm] = []
  for piece, since in pieces(tail, manifest, name, BLOCK):
    for channel in sorted(watch.channels - piece.streams.keys()):
      record.notes.setdefault(channel, f"not watched: {channel}; the data set has it, and this log has no sample of it")
    for channel, stream in piece.streams.items():
      if CHANNELS[channel].noisy and np.ptp(stream.value) == 0.0 and _moves(piece):
        note = f"{channel} stands at {stream.value[0] + 0.0:g} from {clock(since)} on although the car moves"
        record.notes.setdefault(f"{channel} stands", f"{note}; do not trust it")
    told, observations, predicted = watch.take(piece, since)
    record.block(observations, predicted, since, watch, told)
    alarms += told
  return alarms
