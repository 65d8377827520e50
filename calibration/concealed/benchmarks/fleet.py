"""Fleets of equal cars, and of cars one of which is odd: who is accused, at the level of estimates and of driving.

Estimates are drawn with their covariance. Driven fleets are sessions of the independent car, written as a user's logs
lie, calibrated one by one and compared by what `scan --calibrate` runs.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.concealed.proving_ground.car import Car
from calibration.concealed.proving_ground.session import make_session
from calibration.fleet.hierarchy import Reading, compare
from calibration.fleet.history import readings_of
from calibration.fleet.logs import find_logs
from calibration.fleet.scan import scan
from qcar_twin.recordings.dataset import write_dataset
from qcar_twin.recordings.manifest import FILE_NAME

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


@dataclasses.dataclass(frozen=True)
class Judged:
  """What was said of a fleet.

  Attributes:
    accused: cars and days with their parameters.
    found, named: whether the odd car is accused, and of what is odd about it.  alone: and nobody and nothing else is.
    first: the least likely comparison, a sentence.
    place, of, chance: of the odd car in what is odd about it: where among all comparisons by their chance, the least
      likely being 1, and that chance.
  """

  accused: tuple[tuple[str, str], ...]
  found: bool
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
    found=any(unit == car_name(ODD) for unit, _ in accused),
    named=any(is_odd(*one) for one in accused),
    alone=bool(accused) and all(is_odd(*one) for one in accused),
    first=compared[0].sentence,
    place=place + 1,
    of=len(compared),
    chance=compared[place].chance,
  )


def drive_log(folder: Path, seed: int, odd: bool, car: int, log: int) -> None:
  """Drive and calibrate one log of one car, as `scan --calibrate` does; what is done stays done.

  All cars of a fleet are the one of its seed; the odd one has `LOSS` less of `GRIP`.
  """
  place = folder / "logs" / car_name(car) / f"2026-11-{1 + log:02d}"
  if not (place / FILE_NAME).is_file():
    one = Car.draw(np.random.default_rng(seed))
    if odd and car == ODD:
      one = dataclasses.replace(one, **{name: (1.0 - LOSS) * getattr(one, name) for name in GRIP})
    session = make_session(seed + 1000 * (1 + car) + 100 * log, (), _DESIGN, 1.0, one)
    write_dataset(place, place.name, session.vehicle, session.vehicle_std, session.recordings, source=session.source)
  calibrated(folder)


def calibrated(folder: Path) -> list[dict[str, Any]]:
  """Lines of all logs of a driven fleet; only new logs are calibrated."""
  return scan(find_logs(folder / "logs"), folder / "scan.ndjson", "calibrate")


def judged_drives(folder: Path) -> Judged:
  """What is said of a driven fleet."""
  return judged(readings_of(calibrated(folder)), _NAMED)
