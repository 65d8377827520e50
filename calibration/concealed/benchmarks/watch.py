"""A watch on the independent cars: hours without a change, and changes that begin at a random time.

The twin is calibrated, quickly, on one session of a car. Other sessions of the same car, with other drivers, are
watched recording by recording, and then sessions of the car with a change, in random order after some without.
"""

import contextlib
import dataclasses
import functools
import hashlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.concealed.laboratory.written import Session
from calibration.concealed.proving_ground.car import Car
from calibration.concealed.proving_ground.session import Spec, make_sessions
from calibration.concealed.second_car import make_second_session
from calibration.concealed.second_car.session import drawn_car
from calibration.twin_calibration.calibration import calibrate
from calibration.watch.follow import tail_of
from calibration.watch.record import Record, look
from calibration.watch.watch import Alarm, Watch
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.manifest import Manifest, read_manifest
from qcar_twin.recordings.recording import Recording, RecordingError

Which = Literal["first", "second"]
CHANGES = ("grip", "sag", "steering_delay")
_AT_ONCE = 10  # sessions of the first car that are driven side by side
_BEFORE = 8  # recordings without the change that come first
_LOSS = 0.2  # of grip
_RIGID = {"first": ("friction", "cornering_front", "cornering_rear"),
          "second": ("static_friction", "cornering_front", "cornering_rear")}  # fmt: skip
_DESIGN = {"first": "lab", "second": "compact"}
_LOOK = 0.5  # s between looks at a log, as the command does


@dataclasses.dataclass(frozen=True)
class Quiet:
  """Driving without a change that was watched on end.

  Attributes:
    driven: s.  alarms: their sentences.
  """

  driven: float
  alarms: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Seen:
  """How a change was seen.

  Attributes:
    shown: driving that shows it until the alarm, s.  driven: all driving until then, s.
    name, size: of what was named; "" and NaN where nothing was.
  """

  change: str
  shown: float
  driven: float
  name: str
  size: float


def watch_of(car: Which, seed: int) -> Watch:
  """A watch whose twin was calibrated on one session of a car."""
  session = next(_sessions(car, seed, [seed], ""))
  data = DataSet("reference", session.recordings, session.vehicle, session.vehicle_std)
  fit = calibrate(data, "recordings")
  return Watch(fit.twin, fit.theta, data.recordings, fit.command_shift)


def mark_of(watch: Watch) -> str:
  """What tells a watch from those of other twins: a digest of its twin's numbers and of its nulls."""
  nulls = [dataclasses.astuple(null) for pair in watch.nulls for null in pair]
  return hashlib.sha256(repr([watch.theta.tolist(), nulls]).encode()).hexdigest()[:12]


def _sessions(car: Which, seed: int, seeds: Sequence[int], change: str) -> Iterator[Session]:
  """Sessions of one car, each with a driver of its own, with a change or none."""
  one = drawn_car(seed) if car == "second" else Car.draw(np.random.default_rng(seed))
  effects: tuple[tuple[str, float], ...] = ()
  if change == "grip":
    one = dataclasses.replace(one, **{name: (1.0 - _LOSS) * getattr(one, name) for name in _RIGID[car]})
  elif change:
    effects = (({"sag": "battery_sag"}.get(change, change), 1.0),)
  if isinstance(one, Car):
    for first in range(0, len(seeds), _AT_ONCE):
      yield from make_sessions([Spec(k, effects, _DESIGN[car], 1.0, one) for k in seeds[first : first + _AT_ONCE]])
  else:
    yield from (make_second_session(k, effects, _DESIGN[car], 1.0, one) for k in seeds)


def quiet(watch: Watch, car: Which, seed: int, first: int, sessions: int) -> Quiet:
  """Sessions without a change from the place `first` on, watched on end, the evidence begun anew."""
  watch.reset()
  driven, alarms = 0.0, []
  for session in _sessions(car, seed, [seed + 1000 + first + k for k in range(sessions)], ""):
    for recording in session.recordings:
      alarms += [alarm.sentence for alarm in _taken(watch, recording)]
      driven += recording.duration
  return Quiet(driven, tuple(alarms))


def _taken(watch: Watch, recording: Recording) -> list[Alarm]:
  try:
    return watch.take(recording)[0]
  except (RecordingError, ValueError):
    return []  # too short to simulate


@functools.cache
def _without(car: Which, seed: int) -> list[Recording]:
  """What is driven before a change, the same for all changes."""
  return [r for made in _sessions(car, seed, [seed + 2000, seed + 2001], "") for r in made.recordings]


def seen(watch: Watch, car: Which, change: str, seed: int, trials: int) -> Iterator[Seen]:
  """A change of a car, begun after some driving without it, in random orders of its recordings."""
  without = _without(car, seed)
  changed = [r for made in _sessions(car, seed, [seed + 3000, seed + 3001], change) for r in made.recordings]
  for trial in range(trials):
    random = np.random.default_rng([seed, trial])
    watch.reset()
    for place in random.permutation(len(without))[:_BEFORE]:
      _taken(watch, without[place])
    yield _until_alarm(watch, change, [changed[place] for place in random.permutation(len(changed))])


def _until_alarm(watch: Watch, change: str, recordings: Sequence[Recording]) -> Seen:
  shown = driven = 0.0
  for recording in recordings:
    before = driven
    try:
      blocks = watch.blocks(recording)
    except (RecordingError, ValueError):
      continue
    for block, shows in blocks:
      driven = before + block.end - recording.start
      shown += (block.end - block.start) * (change in shows)
      if told := watch.judge(block):
        return Seen(change, shown, driven, told[0].name or "none", told[0].size)
  return Seen(change, shown, driven, "", float("nan"))


def share_of_a_core(watch: Watch, car: Which, seed: int) -> float:
  """Processor time over driving of a watch on logs that grow by `_LOOK` between looks, MCAP at the end included."""
  session = next(_sessions(car, seed, [seed + 4000], ""))
  watch.reset()
  driven = spent = 0.0
  with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    write_dataset(folder / "data", "session", session.vehicle, session.vehicle_std, session.recordings)
    manifest = read_manifest(folder / "data")
    for recording in session.recordings:
      spent += _followed(watch, folder / "data" / f"{recording.name}.csv", recording, manifest, folder)
      driven += recording.duration
  return spent / driven


def _followed(watch: Watch, log: Path, recording: Recording, manifest: Manifest, folder: Path) -> float:
  """Processor time of following one log as it grows, s; the growing itself is not counted."""
  head, *rows = log.read_text(encoding="utf-8").splitlines(keepends=True)
  at_once = max(1, round(_LOOK / recording.duration * len(rows)))
  growing, spent = folder / log.name, 0.0
  growing.write_text(head, encoding="utf-8")
  tail = tail_of(growing)
  with (folder / "watch.ndjson").open("w", encoding="utf-8") as lines:
    record = Record(lines, True)
    for first in range(0, len(rows), at_once):
      with growing.open("a", encoding="utf-8") as file:
        file.writelines(rows[first : first + at_once])
      began = time.process_time()
      with contextlib.suppress(RecordingError, ValueError):  # too short to simulate
        look(watch, tail, manifest, recording.name, record)
      spent += time.process_time() - began
  began = time.process_time()
  if record.blocks:
    record.mcap(folder / "watch.mcap")
  return spent + time.process_time() - began
