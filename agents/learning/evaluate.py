"""Policies and controllers side by side: paths, plants, speeds, mismatch, many seeds; indicators as the paper's.

Every run is `closed_loop.drive` with sensors and federated filter, the same for a network and for LQ.
"""

import dataclasses
import hashlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from agents.control import controllers, figures
from agents.control.closed_loop import Actuation, Drive, Scenario, drive
from agents.control.interface import Controller
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model, known_of_twin
from agents.control.speed import SpeedGains
from agents.control.team import EqualSensors, Team
from agents.learning.environments import SERVO
from agents.learning.policy_file import WEIGHTS
from agents.learning.sb3_zip import any_policy
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.estimation.observer import SensedObserver, TrueObserver
from qcar_twin.parallel import in_order
from qcar_twin.plant import Plant
from qcar_twin.sensors.suite import qcar_sensors
from qcar_twin.tracks import path_from

Array = NDArray[np.float64]
PlantMaker = Callable[[str], tuple[Plant, Array]]
"""A plant by name and its parameters (P,): what scripts give for plants that agents do not know."""
BASELINES = tuple(itertools.product(("ff_fb", "lq_ed", "lq_cm", "linear_rate"), ("loose", "tuned")))
INDICATORS = ("rmse", "me", "iaca", "steering_rate")


@dataclasses.dataclass(frozen=True)
class EvaluationCase:
  """Circumstances of a drive.

  Attributes:
    path: its name.  plant: its name.  speed: m/s.
    steering_gain, steering_offset: of the linkage, - and deg; neither agent nor filter knows them.
    cars: runs, each with sensor noise of its own.  seed: of the sensors.
    estimator: "fekf" or "truth".
    filter_noise: factor on the process noise densities that the filter assumes (`FilterSettings.walk_*`).
    unknown: numbers that the filter estimates besides, of `PRIORS`; none for the filter that the agents learnt with.
    after: s from the start that do not count.
    known_from: twin file from which the filter knows steering and delays; "" for none.
  """

  path: str
  plant: str = "mujoco"
  speed: float = 0.5
  steering_gain: float = 1.0
  steering_offset: float = 0.0
  cars: int = 4
  seed: int = 500
  estimator: str = "fekf"
  filter_noise: float = 1.0
  unknown: tuple[str, ...] = ()
  known_from: str = ""
  after: float = 0.0

  @property
  def label(self) -> str:
    """Everything but the path, in words."""
    wrong = self.steering_gain != 1.0 or self.steering_offset != 0.0
    mismatch = f", gain {self.steering_gain:g}, offset {self.steering_offset:+g} deg" if wrong else ""
    noise = f", filter noise x {self.filter_noise:g}" if self.filter_noise != 1.0 else ""
    besides = f", estimating {', '.join(self.unknown)}" if self.unknown else ""
    late = f", from {self.after:g} s on" if self.after else ""
    known = f", known from {self.known_from}" if self.known_from else ""
    return f"{self.plant}, {self.speed:g} m/s{mismatch}{noise}{besides}{known}{late}"


def known_plant(name: str) -> tuple[Plant, Array]:
  """The twin or the bicycle with nominal numbers."""
  return Model.nominal().plant(name)


def run_case(controller: Controller, case: EvaluationCase, plant: PlantMaker = known_plant) -> Drive:
  """Drive one case with `case.cars` cars; a team's members one after another, with `case.cars` each."""
  model, groups = Model.nominal(), len(controller.members) if isinstance(controller, Team) else 1
  count = groups * case.cars
  body, theta = plant(case.plant)
  delay, lag = SERVO if case.plant == "bicycle" else (0.0, 0.0)
  actuation = Actuation(delay, lag, case.steering_gain, float(np.radians(case.steering_offset)))
  scenario = Scenario(path_from(case.path), case.speed, lock=model.vehicle.max_steering, actuation=actuation)
  observer = TrueObserver()
  if case.estimator == "fekf":
    settings = model.filter_settings("bicycle" if case.plant == "bicycle" else "mujoco").with_walks(case.filter_noise)
    if case.known_from:
      settings = settings.with_known(known_of_twin(case.known_from))
    settings = settings.estimating(*case.unknown)
    sensors = EqualSensors(qcar_sensors(), groups, case.cars, case.seed)
    observer = SensedObserver(sensors, model.car, settings)  # type: ignore[arg-type]
  return drive(body, np.tile(theta, (count, 1)), controller, SpeedGains.design(model.car), observer, scenario)


def run_together(
  controllers: Mapping[str, Controller], case: EvaluationCase, plant: PlantMaker = known_plant
) -> list["Row"]:
  """Drive one case with several controllers in one simulation: a row each, equal to what each gets alone."""
  driven = run_case(Team(tuple(controllers.values()), case.cars), case, plant).after(case.after)
  groups = (slice(i * case.cars, (i + 1) * case.cars) for i in range(len(controllers)))
  return [Row(label, case, kpis(driven.cars(group))) for label, group in zip(controllers, groups, strict=True)]


def contestants(policies: Mapping[str, Path], speed: float, baselines: bool = True) -> dict[str, Controller]:
  """Controllers of the shipped file by "name version", designed for a speed, m/s, and policies by their label."""
  drivers: dict[str, Controller] = {}
  if baselines:
    table = controllers.load(Model.nominal().car, speed)
    drivers |= {f"{name} {version}": table[name, version] for name, version in BASELINES if (name, version) in table}
  return drivers | {label: any_policy(folder) for label, folder in policies.items()}


@dataclasses.dataclass(frozen=True)
class Row:
  """Indicators of one contestant in one case, each with one value per car."""

  contestant: str
  case: EvaluationCase
  kpis: Kpis

  def as_json(self) -> dict[str, Any]:
    values = {f.name: np.asarray(getattr(self.kpis, f.name)).tolist() for f in dataclasses.fields(self.kpis)}
    finite = {name: [v if np.isfinite(v) else None for v in column] for name, column in values.items()}
    return {"contestant": self.contestant, "case": dataclasses.asdict(self.case), **finite}


def _everybody(
  policies: Mapping[str, Path], case: EvaluationCase, plant: PlantMaker, versions: Sequence[str]
) -> list[Row]:
  """All contestants in one case; loads what it needs, so that it can run in another process."""
  drivers = contestants(policies, case.speed, baselines=bool(versions))
  return run_together(
    {label: c for label, c in drivers.items() if label in policies or label.split()[1] in versions}, case, plant
  )


def evaluate(
  policies: Mapping[str, Path],
  cases: Sequence[EvaluationCase],
  plant: PlantMaker = known_plant,
  workers: int = 1,
  ray: bool = False,
  versions: Sequence[str] = ("loose", "tuned"),
) -> list[Row]:
  """Every policy, and the controllers they are measured against, in every case; a case is one simulation.

  Args:
    policies: folder by label; several seeds of one training are several policies.
    plant: makes the plants the cases name.
    workers: processes.
    versions: of the controllers of agents/data/controllers.toml; none for the policies alone.
    ray: send the work to the Ray cluster at hand (RAY_ADDRESS), or a local one, instead of local processes.
  """
  calls = [joblib.delayed(_everybody)(policies, case, plant, versions) for case in cases]
  return list(itertools.chain.from_iterable(in_order(calls, workers, ray)))


def summary(rows: Sequence[Row], group: Callable[[str], str] = lambda label: label) -> list[dict[str, Any]]:
  """Median and quartiles over all cars and seeds of a group, per case.

  Args:
    group: what a contestant's label counts as, to bring the seeds of one training together.
  """
  together: dict[tuple[str, EvaluationCase], list[Kpis]] = {}
  for row in rows:
    together.setdefault((group(row.contestant), row.case), []).append(row.kpis)
  table = []
  for (name, case), runs in together.items():
    entry: dict[str, Any] = {
      "contestant": name,
      "path": case.path,
      "circumstances": case.label,
      "trainings": len(runs),
    }
    for indicator in INDICATORS:
      values = np.concatenate([getattr(k, indicator) for k in runs])
      low, middle, high = np.quantile(np.minimum(values, 1e9), [0.25, 0.5, 0.75])
      entry[indicator] = middle if middle < 1e8 else None
      entry[f"{indicator}_quartiles"] = [low if low < 1e8 else None, high if high < 1e8 else None]
    entry["finished"] = float(np.mean(np.concatenate([k.finished for k in runs])))
    entry["inside"] = float(np.mean(np.concatenate([k.inside for k in runs])))
    table.append(entry)
  return table


def in_words(table: Sequence[Mapping[str, Any]]) -> str:
  """A summary as text: one line per contestant under a heading per path and circumstances."""
  lines: list[str] = []
  for key in dict.fromkeys((e["path"], e["circumstances"]) for e in table):
    lines.append(
      f"\n{key[0]} ({key[1]}): RMSE mm, ME mm, IACA deg: median [quartiles]; between the borders or finished"
    )
    for entry in (e for e in table if (e["path"], e["circumstances"]) == key):
      cells = [_cell(entry, name, scale) for name, scale in (("rmse", 1e3), ("me", 1e3), ("iaca", np.degrees(1.0)))]
      lines.append(f"  {entry['contestant']:<20}" + "  ".join(cells) + f"  {100.0 * entry['inside']:3.0f} %")
  return "\n".join(lines).strip()


def _cell(entry: Mapping[str, Any], name: str, scale: float) -> str:
  low, high = entry[f"{name}_quartiles"]
  say = lambda x: "  left" if x is None else f"{scale * x:6.1f}"
  return f"{say(entry[name])} [{say(low)}, {say(high)}]"


def write_evaluation(
  folder: Path,
  rows: Sequence[Row],
  group: Callable[[str], str] = lambda label: label,
  policies: Mapping[str, Path] | None = None,
) -> str:
  """Write evaluation.json, a table, and bars of the indicators per circumstances; returns the table.

  Args:
    policies: that were driven, by label: what each is goes into the file, with the hash of its weights.
  """
  folder.mkdir(parents=True, exist_ok=True)
  table = summary(rows, group)
  text = in_words(table)
  about = {label: described(place) for label, place in (policies or {}).items()}
  content = {"policies": about, "summary": table, "runs": [row.as_json() for row in rows]}
  write_json(folder / "evaluation.json", content)
  write_text(folder / "evaluation.txt", text + "\n")
  for number, circumstances in enumerate(dict.fromkeys(e["circumstances"] for e in table)):
    bars: dict[str, dict[str, tuple[float, float, float]]] = {}
    for e in (e for e in table if e["circumstances"] == circumstances):
      rmse, me, iaca = (np.nan if e[name] is None else float(e[name]) for name in ("rmse", "me", "iaca"))
      bars.setdefault(e["path"], {})[e["contestant"]] = (rmse, me, iaca)
    figures.indicator_figure(bars, folder / f"indicators_{number}.png")
  return text


def described(place: Path) -> dict[str, Any]:
  """What a policy is, and the SHA-256 of the file that holds its weights."""
  policy, file = any_policy(place), place if place.is_file() else place / WEIGHTS
  return {"kind": policy.name, "about": policy.about, "updates": policy.updates, "sha256": digest(file)}


def digest(file: Path) -> str:
  """SHA-256 of a file."""
  return hashlib.sha256(file.read_bytes()).hexdigest()
