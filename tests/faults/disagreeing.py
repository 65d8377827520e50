"""How the numbers that decide whether two sensors disagree were chosen: what each does to sound and to false logs.

Sound are drives by formula of four sizes with what real sensors do (noise, roll, slip, lags of a bus, a slow servo,
understeer), sessions of both independent cars and the real sets; false are the same with one falsity. Comparisons are
made once, since no number takes part in them; each number is then varied by itself
(`python -m tests.faults.thresholds --sensors`).
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType

import numpy as np

from calibration.fitting.noise import ChannelNoise, noise_models
from calibration.log_check import alternatives, causes, disagreements
from calibration.log_check.alternatives import Alternative, compared_so
from calibration.log_check.motions import Motion, Wheels, motions
from calibration.log_check.pairs import Comparison, compare
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle
from tests import REAL
from tests.faults.door.sources import Log, by_formula, first_car, second_car
from tests.faults.falsities import EVERY, SIZES, Array, Columns

NUMBERS: tuple[tuple[str, tuple[ModuleType, ...]], ...] = (
  ("ALIKE", (causes, disagreements)),
  ("LATE", (causes, disagreements)),
  ("FACTOR", (causes, disagreements)),
  ("KNOTS", (causes, disagreements)),
  ("_A_UNIT", (causes,)),
  ("TIED", (disagreements,)),
  ("_BETTER", (disagreements,)),
  ("_CONTRARY", (disagreements,)),
  ("_LOUD", (disagreements,)),
  ("_AGREE", (alternatives,)),
  ("_NEAR", (alternatives,)),
)
CORRELATIONS = {"ALIKE", "TIED", "_CONTRARY", "_AGREE"}
OVER_ONE = {"FACTOR", "KNOTS", "_NEAR"}  # factors, of which 1 is none: their logarithms are varied
UNSEEN = (
  "motor_voltage",
  "about 0.6 rad",
  "30 %",
  "released",
  "stamp of the day",
  "time as steps",
  "set back",
  "pose_yaw wrapped",
)
"""Parts of the names of falsities that two sensors don't see, or that the loader meets: not of these numbers."""
FALSE = [f for f in EVERY if not f.only and not any(part in f.name for part in UNSEEN)]


def _noisy(channel: str, share: float) -> Callable[[Array, Columns], tuple[Array, Columns]]:
  def change(time: Array, columns: Columns) -> tuple[Array, Columns]:
    v = columns[channel]
    noise = np.random.default_rng(3).standard_normal(v.size)
    return time, columns | {channel: v + share * np.nanstd(v) * noise}

  return change


def _later(channel: str, seconds: float) -> Callable[[Array, Columns], tuple[Array, Columns]]:
  return lambda t, c: (t, c | {channel: np.interp(t - seconds, t, c[channel])})


def _rolling(time: Array, columns: Columns) -> tuple[Array, Columns]:
  """An accelerometer on a body that leans out of turns by 0.02 rad per m/s^2: it feels 1.2 times as much."""
  return time, columns | {"accel_y": 1.2 * columns["accel_y"], "accel_x": 1.1 * columns["accel_x"]}


def _understeering(time: Array, columns: Columns) -> tuple[Array, Columns]:
  """A command that has to be up to half as large again at the top speed."""
  share = 1.0 + 0.5 * (columns["speed"] / columns["speed"].max()) ** 2
  return time, columns | {"steering_command": columns["steering_command"] * share}


SOUND: dict[str, Callable[[Array, Columns], tuple[Array, Columns]]] = {
  "as it is": lambda t, c: (t, c),
  "accel_x noise of half its motion": _noisy("accel_x", 0.5),
  "accel_y noise of half its motion": _noisy("accel_y", 0.5),
  "accel_x noise of twice its motion": _noisy("accel_x", 2.0),
  "a body that leans": _rolling,
  "yaw_rate 0.1 s late": _later("yaw_rate", 0.1),
  "speed 0.2 s late": _later("speed", 0.2),
  "steering answers in 0.3 s": _later("steering_command", -0.3),
  "understeer": _understeering,
}


@dataclasses.dataclass(frozen=True)
class Case:
  """A log with its comparisons, made once.

  Attributes:
    false: whether something has to be found.
    others: comparisons by other readings, by the name of the motion.
  """

  name: str
  false: bool
  wheels: Wheels
  wheelbase: float
  recordings: Sequence[Recording]
  noise: dict[str, ChannelNoise]
  compared: list[Comparison]
  others: dict[str, list[tuple[Alternative, Comparison]]]

  @classmethod
  def of(cls, name: str, false: bool, recordings: Sequence[Recording], vehicle: Vehicle) -> "Case":
    noise, wheels = noise_models(recordings), Wheels.of(vehicle, recordings)
    compared = [compare(motion, wheels, recordings, noise) for motion in motions(wheels, recordings)]
    others = {
      c.motion.name: compared_so(c.motion, wheels, recordings, noise)
      for c in compared
      if not c.why_not and not c.motion.answers and c.whole < 0.99
    }
    return cls(name, false, wheels, vehicle.wheelbase, recordings, noise, compared, others)

  def found(self) -> bool:
    """Whether a comparison says that the log is spoilt."""
    return any(f.severity == "spoils" for f in self.findings())

  def findings(self) -> Iterator[disagreements.Finding]:
    for c in self.compared:
      yield from disagreements.disagreements(c, self.wheels, self.wheelbase, self.recordings, self.noise)
    yield from disagreements.scale_findings(self.compared, self.wheelbase, stated=True)


def cases(seed: int, per_size: int = 1) -> list[Case]:
  """Sound and false logs of all sources."""
  random, made = np.random.default_rng(seed), []
  for size in [*SIZES] * per_size:
    log = by_formula(int(random.integers(2**31)), size)
    made += [_case(f"{name}, {size}", False, log.changed(change)) for name, change in SOUND.items()]
    made += _false(log)
  for session in (first_car(seed), second_car(seed)):
    made += [_case(session.source, False, session), *_false(session)]
  return [*made, *(_real(name) for name in ("cpm_ucar", "dart") if (REAL / name).is_dir())]


def _real(name: str) -> Case:
  """A real set as it is loaded."""
  data = DataSet.load(REAL / name)
  return Case.of(name, False, data.recordings, Vehicle.from_dataset(data.vehicle, data.vehicle_std))


def few(seed: int, sound: Sequence[str], false: Sequence[str]) -> list[Case]:
  """Some of them, of one drive of a 1:10 car."""
  log = by_formula(seed, "1:10")
  made = [_case(name, False, log.changed(SOUND[name])) for name in sound]
  return [*made, *(_case(f.name, True, log.changed(f.apply)) for f in EVERY if f.name in false)]


def _false(log: Log) -> list[Case]:
  fitting = [f for f in FALSE if f.applies(log.channels)]
  return [_case(f"{f.name}, {log.source}", True, log.changed(f.apply)) for f in fitting]


def _case(name: str, false: bool, log: Log) -> Case:
  runs = [Recording.from_columns(r.file, r.time, r.columns) for r in log.runs]
  recordings = [with_speed(run)[0] for run in runs]
  vehicle = Vehicle.from_dataset(log.vehicle["vehicle"], log.vehicle.get("vehicle.std", {}))
  return Case.of(name, false, recordings, vehicle)


@contextmanager
def _remembered(all_cases: Sequence[Case]) -> Iterator[None]:
  """Comparisons by other readings are looked up, not made again."""
  kept = {(id(case.recordings), name): pairs for case in all_cases for name, pairs in case.others.items()}

  def looked_up(motion: Motion, wheels: Wheels, recordings: Sequence[Recording], noise: dict[str, ChannelNoise]):
    key = (id(recordings), motion.name)
    if key not in kept:
      kept[key] = compared_so(motion, wheels, recordings, noise)
    return kept[key]

  with with_number((alternatives,), "compared_so", looked_up):
    yield


@contextmanager
def with_number(modules: Sequence[ModuleType], name: str, value: object) -> Iterator[None]:
  """A name of several modules set for a while."""
  before = [getattr(module, name) for module in modules]
  for module in modules:
    setattr(module, name, value)
  try:
    yield
  finally:
    for module, old in zip(modules, before, strict=True):
      setattr(module, name, old)


def varied(name: str, value: float, factor: float) -> float:
  """A number times a factor: of a correlation its distance from what it must not be, of a ratio its logarithm."""
  if name == "_A_UNIT" or name not in CORRELATIONS | OVER_ONE:
    return value * factor
  if name in OVER_ONE:
    return math.exp(factor * math.log(value))
  return math.copysign(1.0 - (1.0 - abs(value)) * factor, value) if factor * (1.0 - abs(value)) < 1.0 else 0.0


def table(all_cases: Sequence[Case], factors: Sequence[float]) -> Iterator[str]:
  """Rows of a table: a number's name, its value, errors of both kinds at every factor."""
  for name, modules in NUMBERS:
    value, cells = getattr(modules[0], name), []
    for factor in factors:
      with with_number(modules, name, varied(name, value, factor)):
        alarms, missed = errors(all_cases)
      cells.append(f"{len(alarms)}, {len(missed)}")
    yield f"| {name} | {value:.3g} | " + " | ".join(cells) + " |"


def errors(all_cases: Sequence[Case]) -> tuple[list[str], list[str]]:
  """Sound logs that are called spoilt, and false ones that are not."""
  with _remembered(all_cases):
    alarms = [c.name for c in all_cases if not c.false and c.found()]
    return alarms, [c.name for c in all_cases if c.false and not c.found()]


def report(drives: int, seed: int, factors: Sequence[float]) -> None:
  """Errors as it is and with every number varied."""
  made = cases(seed, drives)
  print(f"{sum(not c.false for c in made)} sound and {sum(c.false for c in made)} false logs")
  alarms, missed = errors(made)
  print("called spoilt:", *alarms, sep="\n  ")
  print("not called spoilt:", *missed, sep="\n  ")
  print("| number | in use | " + " | ".join(f"x {factor:g}" for factor in factors) + " |")
  print("|---" * (2 + len(factors)) + "|")
  for row in table(made, factors):
    print(row, flush=True)
