"""Sound logs to falsify: drives by formula, sessions of both independent cars, the real sets where they lie."""

import dataclasses
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.concealed.laboratory.written import Session
from calibration.concealed.proving_ground import Spec
from calibration.concealed.proving_ground.long_session import make_long_session
from calibration.concealed.second_car import make_second_session
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.formats import read_table
from tests import REAL
from tests.faults.falsities import NAMES, RATE, SIZES, Columns, wander
from tests.qcar_twin.recordings.drives import VEHICLE, write_csv

Array = NDArray[np.float64]
Change = Callable[[Array, Columns], tuple[Array, Columns]]
STRANGE = NAMES | {"motor_speed": "motor_omega", "pose_score": "quality"}
POWERS = {"mass": 3, "yaw_inertia": 5, "gear_ratio": 0, "max_steering": 0}  # of length, among similar cars
REAL_FILES = 9  # of a real set, evenly from all of its files: dart's 35 take 5 s a case


@dataclasses.dataclass(frozen=True)
class Run:
  """One file of a log.

  Attributes:
    about: keys of its [[recording]].
    time: (k,) s.
    columns: by channel, SI; NaN where the cell is blank.
    others: columns that are no channel, such as a gate.
  """

  file: str
  about: Mapping[str, str]
  time: Array
  columns: Columns
  others: Columns = dataclasses.field(default_factory=dict)

  def changed(self, change: Change) -> "Run":
    time, columns = change(self.time, self.columns | self.others)
    others = {name: columns.pop(name) for name in self.others if name in columns}
    return dataclasses.replace(self, time=time, columns=columns, others=others)


@dataclasses.dataclass(frozen=True)
class Log:
  """A log in SI units.

  Attributes:
    vehicle: tables [vehicle] and [vehicle.std].
    keys: of [channels] besides column, scale and offset: wrap, hold, gate.
    names: channel -> column, factor and offset of a stranger's file: value = factor * cell + offset.
    clock: the stranger's name for time.
  """

  source: str
  runs: tuple[Run, ...]
  vehicle: Mapping[str, Mapping[str, float | str]]
  keys: Mapping[str, Mapping[str, object]]
  names: Mapping[str, tuple[str, float, float]]
  clock: str = "time"

  @property
  def channels(self) -> set[str]:
    return {name for run in self.runs for name in run.columns}

  def changed(self, change: Change) -> "Log":
    """Every run of it changed."""
    return dataclasses.replace(self, runs=tuple(run.changed(change) for run in self.runs))

  def only(self, channels: tuple[str, ...]) -> "Log":
    """The runs that hold all of these channels, without other channels."""
    kept = lambda name: name in channels or name not in CHANNELS
    few = self.changed(lambda t, c: (t, {name: v for name, v in c.items() if kept(name)}))
    return dataclasses.replace(few, runs=tuple(run for run in few.runs if set(channels) <= run.columns.keys()))

  def thinned(self, every: int) -> "Log":
    """One row in so many, as a slower logger has."""
    return self.changed(lambda t, c: (t[::every], {name: v[::every] for name, v in c.items()}))

  def write(self, folder: Path) -> None:
    """As a data set whose person knows every channel."""
    lines = ['name = "lab"']
    for table, content in self.vehicle.items():
      lines += [f"[{table}]", *(f"{k} = {_toml(v)}" for k, v in content.items())]
    if keys := {c: v for c, v in self.keys.items() if c in self.channels}:
      lines += ["[channels]"]
      for channel, more in keys.items():
        said = ", ".join(f"{k} = {_toml(v)}" for k, v in {"column": channel, **more}.items())
        lines += [f"{channel} = {{ {said} }}"]
    for run in self.runs:
      lines += ["[[recording]]", *(f"{k} = {_toml(v)}" for k, v in {**run.about, "file": run.file}.items())]
      write_csv(folder / run.file, run.time, run.columns | run.others)
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")

  def write_strange(self, folder: Path) -> None:
    """As files of a stranger, without a dataset.toml."""
    for run in self.runs:
      columns = {}
      for channel, values in run.columns.items():
        name, factor, offset = self.names[channel]
        columns[name] = (values - offset) / factor
      path = write_csv(folder / run.file, run.time, columns | run.others)
      head, _, rest = path.read_text(encoding="utf-8").partition("\n")
      path.write_text(f"{self.clock}{head[len('time') :]}\n{rest}", encoding="utf-8")


def by_formula(seed: int, size: str = "", seconds: float = 90.0) -> Log:
  """A drive by formula of a car of some size."""
  size = size or list(SIZES)[seed % len(SIZES)]
  time, columns = wander(seed, SIZES[size], seconds)
  numbers = {k: v * SIZES[size] ** POWERS.get(k, 1) for k, v in VEHICLE.items() if not isinstance(v, str)}
  names = {channel: (STRANGE[channel], 1.0, 0.0) for channel in columns}
  run = Run("run.csv", {"role": "identify"}, time, columns)
  return Log(f"formula, {size}", (run,), {"vehicle": numbers}, {}, names)


def first_car(seed: int) -> Log:
  """A compact session of the proving ground's car."""
  return _session("first car", make_long_session(Spec(seed, (), "compact", 1.0), 1))


def second_car(seed: int) -> Log:
  """A compact session of the second car."""
  return _session("second car", make_second_session(seed, (), "compact", 1.0))


def _session(name: str, session: Session) -> Log:
  runs = []
  for recording in session.recordings:
    time, columns = recording.columns()
    about = {"role": recording.role, "manoeuvre": recording.manoeuvre, "session": recording.session}
    runs.append(Run(recording.file, about, time, columns))
  vehicle = {"vehicle": session.vehicle, "vehicle.std": session.vehicle_std}
  channels = {channel for run in runs for channel in run.columns}
  return Log(name, tuple(runs), vehicle, {}, {channel: (STRANGE[channel], 1.0, 0.0) for channel in channels})


def real_set(name: str) -> Log:
  """A real set, with the reading of the person who looked at it."""
  manifest = tomllib.loads((REAL / name / "dataset.toml").read_text(encoding="utf-8"))
  mapping = {c: m for c, m in manifest["channels"].items() if c != "time"}
  clock = manifest["channels"].get("time", {"column": "time"})["column"]
  how = {c: (m["column"], float(m.get("scale", 1.0)), float(m.get("offset", 0.0))) for c, m in mapping.items()}
  entries, runs = manifest["recording"], []
  kept = np.unique(np.linspace(0, len(entries) - 1, min(REAL_FILES, len(entries))).round().astype(int))
  for entry in (entries[k] for k in kept):
    table = read_table(REAL / name / entry["file"], entry["file"])
    number = lambda column, table=table: np.asarray(table.columns[column], float)
    held = {c: m for c, m in how.items() if m[0] in table.columns}
    columns = {c: factor * number(column) + offset for c, (column, factor, offset) in held.items()}
    taken = {clock, *(column for column, _, _ in how.values())}
    others = {column: number(column) for column in table.columns if column not in taken}
    about = {k: v for k, v in entry.items() if k != "file" and isinstance(v, str)}
    runs.append(Run(Path(entry["file"]).name, about, number(clock), columns, others))
  own = dict(manifest["vehicle"])
  vehicle = {"vehicle": {k: v for k, v in own.items() if k != "std"}, "vehicle.std": own.get("std", {})}
  keys = {c: {k: m[k] for k in ("wrap", "hold", "gate") if k in m} for c, m in mapping.items()}
  return Log(name, tuple(runs), vehicle, {c: k for c, k in keys.items() if k}, how, clock)


REAL_SETS = ("qcar_ground", "cpm_ucar", "dart")


def sources(seed: int) -> tuple[dict[str, Log], list[str]]:
  """Logs of every source, and why one is left out."""
  made = {log.source: log for log in (by_formula(seed + k, size) for k, size in enumerate(SIZES))}
  made |= {"first car": first_car(seed), "second car": second_car(seed)}
  absent = [f"{name}: {REAL / name} is not here" for name in REAL_SETS if not (REAL / name).is_dir()]
  return made | {name: real_set(name) for name in REAL_SETS if (REAL / name).is_dir()}, absent


def sound(count: int, seed: int) -> list[tuple[Log, bool]]:
  """Sound logs of all sources, rates and sizes, and whether each is read as `new` drafts it."""
  sizes, logs = list(SIZES), []
  for k in range(24):
    logs += [(by_formula(seed + k, sizes[k % 4]).thinned((1, 2, 3)[k % 3]), k % 8 == 1)]
  for k in range(4):
    session = first_car(seed + k)
    logs += [(session.thinned(every), False) for every in (1, 2, 4)] + [(session, True)]
  for k in range(3):
    session = second_car(seed + k)
    logs += [(session.thinned(every), False) for every in (1, 2, 4)] + [(session, True)]
  for name in (name for name in REAL_SETS if (REAL / name).is_dir()):
    logs += [(real_set(name), False), (real_set(name), True)]
  more = (by_formula(seed + k, sizes[k % 4], 60.0 + k) for k in range(24, count))
  return [*logs, *((log, False) for log in more)][:count]


def _toml(value: object) -> str:
  if isinstance(value, bool):
    return "true" if value else "false"
  return f'"{value}"' if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]


__all__ = ["RATE", "Log", "Run", "by_formula", "first_car", "real_set", "second_car", "sound", "sources"]
