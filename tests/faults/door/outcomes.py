"""What becomes of a false log: right, refused, warned of or passed wrongly, by the check and then by a calibration.

The truth is the same log without the falsity, read the same way.
"""

import dataclasses
import re
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.log_check.check import LogCheck, check_log, load_to_check
from calibration.twin_calibration.calibration import Calibration, calibrate
from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.completed import UNJUDGED
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.vehicle.vehicle import Vehicle
from tests.faults.door.sources import Log
from tests.faults.falsities import Falsity

Array = NDArray[np.float64]
SHARE = 1e-6  # of a channel's largest value that a repair may be off: as units are written, to six digits
GUESSED = 0.06  # the same of the steering, whose scale is drafted with a wheelbase that nobody said
DEVIATIONS = 0.5  # of its own posterior that a parameter may move by what a repair leaves


@dataclasses.dataclass(frozen=True)
class Truth:
  """A log without a falsity, as it is read: its check and, once asked for, its calibration."""

  log: Log
  drafted: bool
  check: LogCheck
  kept: dict[str, Calibration] = dataclasses.field(default_factory=dict)

  @classmethod
  def of(cls, log: Log, drafted: bool) -> "Truth":
    """Raises RecordingError where the sound log is refused, or only asked about."""
    return cls(log, drafted, read(log, drafted))

  def calibrated(self) -> Calibration:
    if "fit" not in self.kept:
      self.kept["fit"] = fitted(self.check)
    return self.kept["fit"]


@dataclasses.dataclass(frozen=True)
class Outcome:
  """Attributes:
  checked: "right", "refused", "warned" or "passed wrongly".
  calibrated: "same", "refused", "warned" or "differs"; "" where the check refuses.
  said: why.
  """

  checked: str
  calibrated: str
  said: str


def read(log: Log, drafted: bool) -> LogCheck:
  """A log written, drafted by `new` where asked for, loaded and checked."""
  with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    if drafted:
      log.write_strange(folder)
      tables = [read_table(folder / run.file, run.file) for run in log.runs]
      (folder / "dataset.toml").write_text(propose("lab", tables).text, encoding="utf-8")
    else:
      log.write(folder)
    return check_log(load_to_check(folder))


def fitted(check: LogCheck) -> Calibration:
  return calibrate(check.dataset, "recordings", quick=True, threads=1)


def outcome(falsity: Falsity, truth: Truth, calibrating: bool = True) -> Outcome:
  """One falsity of one log."""
  if falsity.only:
    truth = Truth.of(truth.log.only(falsity.only), truth.drafted)
  try:
    check = read(truth.log.changed(lambda t, c: falsity.apply(t, c) if falsity.applies(c) else (t, c)), truth.drafted)
  except RecordingError as error:
    return Outcome("refused", "", str(error))
  if spoiling := check.of("spoils"):
    return Outcome("refused", "", spoiling[0].text)
  checked, said = judged(falsity, truth, check)
  return Outcome(checked, _by_fit(falsity, truth, check) if calibrating else "", said)


def judged(falsity: Falsity, truth: Truth, check: LogCheck) -> tuple[str, str]:
  """ "right", "warned" or "passed wrongly", and what was said."""
  if _same(check.dataset, truth.check.dataset, GUESSED if truth.drafted else SHARE):
    return "right", check.verdict
  said = _named(falsity, truth, check)
  return ("warned", said[0]) if said else ("passed wrongly", check.verdict)


def _named(falsity: Falsity, truth: Truth, check: LogCheck) -> list[str]:
  """What is said of the falsity's channels: not said of the true log, too, unless it is that nothing judges them."""
  before = {f.text for f in truth.check.of("beware")}
  texts = [f.text for f in check.of("beware") if f.text not in before or UNJUDGED in f.text]
  drives = DRIVE_COMMANDS if "motor_voltage" in falsity.channels else ()
  return [text for text in texts if any(channel in text for channel in (*falsity.channels, *drives))]


def _by_fit(falsity: Falsity, truth: Truth, check: LogCheck) -> str:
  """Whether a calibration gives the true log's parameters, refuses, or says what the check says."""
  try:
    mine = fitted(check)
  except RecordingError:
    return "refused"
  theirs = truth.calibrated()
  if all(
    abs(e.value - theirs.estimates[name].value) <= DEVIATIONS * theirs.estimates[name].noise_std
    for name, e in mine.estimates.items()
    if name in theirs.estimates
  ):
    return "same"
  named = {_worded(text) for text in _named(falsity, truth, check)}
  return "warned" if named & {_worded(note) for note in mine.notes} else "differs"


def _worded(text: str) -> str:
  """Without numbers: a fit's are of what is not held out."""
  return re.sub(r"[-+]?\d[\d.e+-]*", "#", text)


def _same(mine: DataSet, theirs: DataSet, steering: float) -> bool:
  """Whether two data sets are the same drive, up to whole turns of the heading and where their clocks begin; steering
  by the curvature that it is for a wheelbase."""
  ours, others = _whole(mine), _whole(theirs)
  if ours.keys() != others.keys():
    return False
  for key, (time, value) in others.items():
    at, read = ours[key]
    if len(at) != len(time) or np.abs((at - at[0]) - (time - time[0])).max() > 1e-5:
      return False
    name, share = key[1], SHARE
    if name == "steering_command" and steering > SHARE:
      read, value, share = read / _wheelbase(mine), value / _wheelbase(theirs), steering
    apart = read - value
    if name == "pose_yaw":  # where it is counted from says nothing without a place
      apart = apart - (_turns(apart[0]) if (key[0], "pose_x") in others else apart[0])
    if np.abs(apart).max() > share * max(1.0, float(np.abs(value).max())):
      return False
  return True


def _turns(angle: float) -> float:
  """The whole turns in an angle, rad."""
  return 2.0 * np.pi * round(angle / (2.0 * np.pi))


def _whole(data: DataSet) -> dict[tuple[str, str], tuple[Array, Array]]:
  """Time and value by file and channel, over all pieces of a file; of two at a cut the sample, not its hold."""
  parts: dict[tuple[str, str], list[tuple[Array, Array]]] = {}
  for recording in data.recordings:
    for name, stream in recording.streams.items():
      parts.setdefault((recording.file, name), []).append((stream.time, stream.value))
  joined = {key: tuple(np.concatenate(each)[::-1] for each in zip(*p, strict=True)) for key, p in parts.items()}
  first = {key: np.unique(np.round(time, 6), return_index=True)[1] for key, (time, _) in joined.items()}
  return {key: (time[first[key]], value[first[key]]) for key, (time, value) in joined.items()}


def _wheelbase(data: DataSet) -> float:
  return Vehicle.from_dataset(data.vehicle, data.vehicle_std).wheelbase
