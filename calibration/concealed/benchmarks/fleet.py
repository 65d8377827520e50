"""Fleets of equal cars, and of cars one of which is odd: who is accused; and how long a scan of many files takes.

Estimates are drawn with their covariance. Driven fleets are sessions of the independent car, written as a user's logs
lie, calibrated one by one and compared by what `scan --calibrate` runs.
"""

import dataclasses
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.concealed.campaign.intervals import exact_interval
from calibration.concealed.proving_ground.car import Car
from calibration.concealed.proving_ground.session import make_session
from calibration.fleet.hierarchy import Reading, compare
from calibration.fleet.history import readings_of
from calibration.fleet.logs import find_logs
from calibration.fleet.scan import scan
from calibration.progress import counted
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError

CARS, LOGS = 6, 2
ODD = 3  # place of the odd car
LOSS = 0.2  # of what is odd
PARAMETERS = 14
STD = np.geomspace(0.005, 0.15, PARAMETERS)  # of values of 1: what lies between a weighed mass and a guessed friction
SHARED = 0.5  # correlation of any two estimates of one log
PLACE = 8  # of the parameter that is odd; its deviation is 4 %
GRIP = ("friction", "cornering_front", "cornering_rear")  # of the independent car; all are less on the odd one
_NAMED = ("friction_coefficient", "cornering_stiffness_front", "cornering_stiffness_rear")  # the twin's names for them
_DESIGN = "compact"
KINDS: dict[str, dict[str, float]] = {
  "equal cars": {},
  "equal, stated deviations 1.5 times too small": {"understated": 1.5},
  "equal but for a scatter between cars of one stated deviation": {"scatter": 1.0},
  "the same, of two": {"scatter": 2.0},
  f"one car {100 * LOSS:.0f} % off in a parameter known to 4 %": {"odd": LOSS},
}  # fleets of estimates, and how they are drawn


@dataclasses.dataclass(frozen=True)
class Judged:
  """What was said of a fleet.

  Attributes:
    accused: cars and days with their parameters.
    spotted, named: whether the odd car is accused, and of what is odd about it.  alone: and nobody and nothing else is.
    first: the least likely comparison, a sentence.
    place, of, chance: of the odd car in what is odd about it: where among all comparisons by their chance, the least
      likely being 1, and that chance.
  """

  accused: tuple[tuple[str, str], ...]
  spotted: bool
  named: bool
  alone: bool
  first: str
  place: int
  of: int
  chance: float

  @property
  def anyone(self) -> bool:
    """Whether any car or day is accused."""
    return bool(self.accused)


def car_name(place: int) -> str:
  """Of a fleet's car, also its folder's."""
  return f"car_{place}"


def drawn_fleet(seed: int, odd: float = 0.0, understated: float = 1.0, scatter: float = 0.0) -> list[Reading]:
  """Estimates of `LOGS` logs of each of `CARS` cars.

  Args:
    odd: share by which one car is less in one parameter.
    understated: true over stated deviations.
    scatter: of real differences between all cars, in stated deviations.
  """
  random = np.random.default_rng(seed)
  mixing = np.linalg.cholesky((1.0 - SHARED) * np.eye(PARAMETERS) + SHARED)
  made = []
  for car in range(CARS):
    own = 1.0 + scatter * STD * random.standard_normal(PARAMETERS) if scatter else np.ones(PARAMETERS)
    for log in range(LOGS):
      x = own + understated * STD * (mixing @ random.standard_normal(PARAMETERS))
      if car == ODD:
        x[PLACE] *= 1.0 - odd
      values = {f"p{i}": (float(x[i]), float(STD[i])) for i in range(PARAMETERS)}
      made.append(Reading(car_name(car), f"2026-11-0{1 + log}", values))
  return made


def judged(readings: Sequence[Reading], odd: Sequence[str] = (f"p{PLACE}",)) -> Judged:
  """Compare a fleet's cars and days; `odd`: parameters in which one car really is."""
  compared = sorted(compare(readings), key=lambda c: c.chance)
  accused = tuple((c.unit, c.parameter) for c in compared if c.accused)
  is_odd = lambda unit, parameter: unit == car_name(ODD) and parameter in odd
  places = (k for k, c in enumerate(compared) if is_odd(c.unit, c.parameter))
  place = next(places, len(compared) - 1)
  return Judged(
    accused=accused,
    spotted=any(unit == car_name(ODD) for unit, _ in accused),
    named=any(is_odd(*one) for one in accused),
    alone=bool(accused) and all(is_odd(*one) for one in accused),
    first=compared[0].sentence,
    place=place + 1,
    of=len(compared),
    chance=compared[place].chance,
  )


def shares(fleets: Sequence[Judged]) -> list[str]:
  """Fleets that accuse anyone, find the odd car, name what is odd, and that alone; with exact 95 % intervals."""
  row = []
  for hits in (sum(getattr(f, name) for f in fleets) for name in ("anyone", "spotted", "named", "alone")):
    low, high = exact_interval(hits, len(fleets))
    row.append(f"{hits} of {len(fleets)} ({low:.3f} to {high:.3f})")
  return row


def drive_log(folder: Path, seed: int, odd: bool, car: int, log: int) -> None:
  """Drive and calibrate one log of one car, as `scan --calibrate` does; what is done stays done.

  All cars of a fleet are the one of its seed; the odd one has `LOSS` less of `GRIP` and the same drivers.
  """
  place = folder / "logs" / car_name(car) / f"2026-11-{1 + log:02d}"
  if not (place / FILE_NAME).is_file():
    one = Car.draw(np.random.default_rng(seed))
    if odd and car == ODD:
      one = dataclasses.replace(one, **{name: (1.0 - LOSS) * getattr(one, name) for name in GRIP})
    session = make_session(seed + 1000 * (1 + car) + 100 * log, (), _DESIGN, 1.0, one)
    write_dataset(place, place.name, session.vehicle, session.vehicle_std, session.recordings, source=session.source)
  calibrated(folder)


@dataclasses.dataclass(frozen=True)
class Scanned:
  """A scan of many files by one process.

  Attributes:
    logs, refused: counts.  driven: s of all.  wall, processor: time that it took, s.
  """

  logs: int
  refused: int
  driven: float
  wall: float
  processor: float


def scanned(sample: Path, count: int) -> Scanned:
  """Check `count` copies of a data set's files under other names, each car's logs of one day in a folder.

  Raises:
    RecordingError: the sample holds no CSV file.
  """
  files = sorted(sample.glob("*.csv"))
  if not files:
    raise RecordingError(f"{sample}: holds no CSV file to copy; name the folder of a data set")
  with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    for k in range(count):
      day, car = divmod(k // len(files), CARS)
      place = folder / "logs" / car_name(car) / f"2026-11-{1 + day:02d}"
      place.mkdir(parents=True, exist_ok=True)
      shutil.copyfile(files[k % len(files)], place / f"{files[k % len(files)].stem}_{k}.csv")
    wall, processor = time.perf_counter(), time.process_time()
    lines = scan(find_logs(folder / "logs"), folder / "scan.ndjson", like=sample)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
  refused = [line for line in lines if line["state"] == "refused"]
  return Scanned(len(lines), len(refused), sum(line.get("driven", 0.0) for line in lines), wall, processor)


def calibrated(folder: Path) -> list[dict[str, Any]]:
  """Lines of all logs of a driven fleet; only new logs are calibrated."""
  return scan(find_logs(folder / "logs"), folder / "scan.ndjson", "calibrate")


def judged_drives(equal: Path, odd: Path | None = None) -> Judged:
  """What is said of a driven fleet of equal cars, or of that fleet with the odd car in the place of one of them."""
  lines = calibrated(equal)
  if odd is not None:
    lines = [line for line in lines if line["car"] != car_name(ODD)] + calibrated(odd)
  return judged(readings_of(lines), _NAMED)


def driven_fleets(work: Path, seed: int, fleets: int, logs: int) -> Iterator[tuple[str, bool, Judged]]:
  """Every driven fleet with its name and whether a car is odd, equal ones and odd ones in turn.

  A fleet with an odd car is that of equal ones with one car changed, so only that car is driven again.
  """
  seeds = range(seed, seed + fleets)
  equal, odd = ({one: work / f"{kind}_{one}" for one in seeds} for kind in ("equal", "odd"))
  cars = [(equal[one], one, False, car) for one in seeds for car in range(CARS)]
  cars += [(odd[one], one, True, ODD) for one in seeds]
  places = [(*car, log) for car in sorted(cars, key=lambda car: car[1]) for log in range(logs)]
  for _ in counted((drive_log(*place) for place in places), len(places), "log"):
    pass
  for one in seeds:
    yield equal[one].name, False, judged_drives(equal[one])
    yield odd[one].name, True, judged_drives(equal[one], odd[one])
