"""A watch on the independent cars: hours without a change, and changes that begin at a random time.

The twin is calibrated, quickly, on one session of a car. Other sessions of the same car, with other drivers, are
watched recording by recording, and then sessions of the car with a change, in random order after some without.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np

from calibration.concealed.proving_ground.car import Car
from calibration.concealed.proving_ground.session import Spec, make_sessions
from calibration.concealed.second_car import make_second_session
from calibration.concealed.second_car.session import drawn_car
from calibration.progress import Progress, silent
from calibration.twin_calibration.calibration import calibrate
from calibration.watch.watch import Alarm, Watch
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError

Which = Literal["first", "second"]
CHANGES = ("grip", "sag", "steering_delay")
_AT_ONCE = 10  # sessions that are driven side by side
_BEFORE = 8  # recordings without the change that come first
_LOSS = 0.2  # of grip


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
  data = DataSet("reference", session[0], session[1], session[2])
  fit = calibrate(data, "recordings", quick=True)
  return Watch(fit.twin, fit.theta, [r for r in data.recordings if r.role != "holdout"], fit.command_shift)


def _sessions(car: Which, seed: int, seeds: Sequence[int], change: str) -> Iterator[tuple[Any, Any, Any]]:
  """Recordings, vehicle and its deviations of sessions of one car, with a change or none."""
  if car == "second":
    effects = ((change, 1.0),) if change else ()
    made = (make_second_session(k, effects, "compact", 1.0, drawn_car(seed)) for k in seeds)
    yield from ((s.recordings, s.vehicle, s.vehicle_std) for s in made)
    return
  one = Car.draw(np.random.default_rng(seed))
  if change == "grip":
    less = {name: (1.0 - _LOSS) * getattr(one, name) for name in ("friction", "cornering_front", "cornering_rear")}
    one, effects = dataclasses.replace(one, **less), ()
  else:
    effects = (({"sag": "battery_sag"}.get(change, change), 1.0),) if change else ()
  for first in range(0, len(seeds), _AT_ONCE):
    specs = [Spec(k, effects, "lab", 1.0, one) for k in seeds[first : first + _AT_ONCE]]
    yield from ((s.recordings, s.vehicle, s.vehicle_std) for s in make_sessions(specs))


def nulls(watch: Watch, car: Which, seed: int, sessions: int, progress: Progress = silent) -> tuple[float, list[Alarm]]:
  """Driving without a change, s, and the alarms in it."""
  driven, alarms = 0.0, []
  for k, (recordings, *_) in enumerate(_sessions(car, seed, [seed + 1000 + k for k in range(sessions)], "")):
    progress(f"session {k + 1} of {sessions} without a change, {driven / 3600.0:.1f} h, {len(alarms)} alarms")
    for recording in recordings:
      alarms += _taken(watch, recording)
      driven += recording.duration
  return driven, alarms


def _taken(watch: Watch, recording: Recording) -> list[Alarm]:
  try:
    return watch.take(recording)[0]
  except (RecordingError, ValueError):
    return []  # too short to simulate


def seen(watch: Watch, change: str, seed: int, trials: int) -> Iterator[Seen]:
  """A change of the first car, begun after some driving without it, in random orders of its recordings."""
  without = [r for made in _sessions("first", seed, [seed + 2000, seed + 2001], "") for r in made[0]]
  changed = [r for made in _sessions("first", seed, [seed + 3000, seed + 3001], change) for r in made[0]]
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
        return Seen(change, shown, driven, told[0].change.name, told[0].size)
  return Seen(change, shown, driven, "", float("nan"))
