"""The controller table: paths x controllers x plants x what the controller sees x what it does not know."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from agents.control.closed_loop import Actuation, Drive, Scenario, drive
from agents.control.controllers import side_by_side
from agents.control.interface import Controller
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model
from agents.control.speed import SpeedGains
from qcar_twin import markdown
from qcar_twin.estimation.observer import Observer, SensedObserver, TrueObserver
from qcar_twin.paths import path_named
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

VALIDATION = ("o", "infinity", "c")
NOMINAL, MISMATCHED = "N", "MIS"
STEERING = {NOMINAL: (1.0, 0.0), MISMATCHED: (0.92, np.radians(1.0))}  # gain -, offset rad


@dataclasses.dataclass(frozen=True)
class TrackingCase:
  """One cell of the table.

  Attributes:
    path, plant: by name.  controller: name and version.
    sees: "truth" or "fekf".  steering: NOMINAL or MISMATCHED.
  """

  path: str
  controller: tuple[str, str]
  plant: str
  sees: str
  steering: str = NOMINAL

  @property
  def label(self) -> str:
    """Controller and version."""
    return " ".join(self.controller)


def actuation(plant: str, steering: Sequence[str], repeats: int) -> Actuation:
  """Steering of neighbouring groups of cars. The bicycle gets a servo (20 ms delay, 40 ms lag); the twin has one."""
  gain, offset = np.repeat(np.array([STEERING[name] for name in steering]), repeats, axis=0).T
  own = {"delay": 0.0, "lag": 0.0} if plant != "bicycle" else {}
  return Actuation(gain=gain, offset=offset, **own)


def run_block(
  versions: Mapping[str, Controller], model: Model, plant: str, path: str, sees: str, steering: Sequence[str], runs: int
) -> Drive:
  """All versions of a controller under all steerings at once: groups of cars, steering by steering within a version.

  On the true state one run per group is all there is, on the estimate `runs` with noise of their own.
  """
  each = 1 if sees == "truth" else runs
  count = len(versions) * len(steering) * each
  body, theta = model.plant(plant)
  observer: Observer = TrueObserver()
  if sees == "fekf":
    observer = SensedObserver(SensorSuite(qcar_sensors(), count, 0), model.car, model.filter_settings(plant))
  linkage = actuation(plant, list(steering) * len(versions), each)
  scenario = Scenario(path_named(path), lock=model.vehicle.max_steering, actuation=linkage)
  controller = side_by_side(list(versions.values()), len(steering) * each)
  return drive(body, np.tile(theta, (count, 1)), controller, SpeedGains.design(model.car), observer, scenario)


def run_table(
  families: Mapping[str, Mapping[str, Controller]],
  model: Model,
  plant: str,
  paths: Sequence[str],
  conditions: Sequence[tuple[str, str]],
  runs: int,
) -> tuple[dict[TrackingCase, Kpis], dict[TrackingCase, Drive]]:
  """Indicators and drives of controllers (name -> version -> controller) under conditions (sees, steering)."""
  table, drives = {}, {}
  for name, versions in families.items():
    for path in paths:
      for sees in dict.fromkeys(sees for sees, _ in conditions):
        steering = [s for seen, s in conditions if seen == sees]
        block = run_block(versions, model, plant, path, sees, steering, runs)
        each = len(block.finished) // (len(versions) * len(steering))
        groups = [TrackingCase(path, (name, version), plant, sees, s) for version in versions for s in steering]
        for i, case in enumerate(groups):
          drives[case] = block.cars(slice(i * each, (i + 1) * each))
          table[case] = kpis(drives[case])
  return table, drives


def table_rows(table: Mapping[TrackingCase, Kpis]) -> list[str]:
  """Markdown rows: controller, then RMSE/ME in mm on each path, IACA in degrees and borders on the C-path."""
  paths = list(dict.fromkeys(case.path for case in table))
  errors = [f"{path}: RMSE / ME [mm]" for path in paths]
  titles = ["controller", "sees", "steering", *errors, "IACA [deg]", "rate [deg/s]", "passes the lane change"]
  rows = []
  groups = dict.fromkeys((case.label, case.sees, case.steering) for case in table)
  for label, sees, steering in groups:
    by_path = {c.path: k for c, k in table.items() if (c.label, c.sees, c.steering) == (label, sees, steering)}
    cells = [f"{1e3 * np.median(k.rmse):.1f} / {1e3 * np.median(k.me):.1f}" for k in by_path.values()]
    effort = " / ".join(f"{np.degrees(np.median(k.iaca)):.1f}" for k in by_path.values())
    rate = f"{np.degrees(max(np.median(k.steering_rate) for k in by_path.values())):.0f}"
    passed = f"{int(by_path['c'].inside.sum())} of {len(by_path['c'].inside)}" if "c" in by_path else "-"
    rows.append([label, sees, steering, *cells, effort, rate, passed])
  return markdown.table(titles, rows)
