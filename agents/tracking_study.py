"""The controller table: paths x controllers x plants x what the controller sees x what nobody told it."""

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np

from agents.closed_loop import Actuation, Drive, Task, drive
from agents.control import Controller
from agents.kpis import Kpis, kpis
from agents.model import Model
from agents.speed import SpeedGains
from qcar_twin.estimation.observer import SensedObserver, TrueObserver
from qcar_twin.paths import path_named
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

VALIDATION = ("o", "infinity", "c")
NOMINAL, MISMATCHED = "N", "MIS"
STEERING = {NOMINAL: (1.0, 0.0), MISMATCHED: (0.92, np.radians(1.0))}  # gain -, offset rad


@dataclasses.dataclass(frozen=True)
class Case:
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
    return " ".join(self.controller)


def actuation(plant: str, steering: str) -> Actuation:
  """The bicycle gets a servo (20 ms delay, 40 ms lag); the twin has its own."""
  gain, offset = STEERING[steering]
  own = {"delay": 0.0, "lag": 0.0} if plant != "bicycle" else {}
  return Actuation(gain=gain, offset=offset, **own)


def run_case(case: Case, controller: Controller, model: Model, runs: int, seed: int = 0, twin_file: str = "") -> Drive:
  """Drive one case; on the true state one run is all there is, on the estimate `runs` with noise of their own."""
  plant, theta = model.plant(case.plant, twin_file)
  count = 1 if case.sees == "truth" else runs
  observer = TrueObserver()
  if case.sees == "fekf":
    suite = SensorSuite(qcar_sensors(), count, seed)
    observer = SensedObserver(suite, model.car, model.filter_settings(case.plant))
  task = Task(path_named(case.path), lock=model.vehicle.max_steering, actuation=actuation(case.plant, case.steering))
  return drive(plant, np.tile(theta, (count, 1)), controller, SpeedGains.design(model.car), observer, task)


def run_table(
  cases: Iterable[Case],
  controllers: Mapping[tuple[str, str], Controller],
  model: Model,
  runs: int,
  keep: Iterable[Case] = (),
) -> tuple[dict[Case, Kpis], dict[Case, Drive]]:
  """Indicators of all cases, and the drives of those to be drawn."""
  keep = set(keep)
  table, drives = {}, {}
  for case in cases:
    result = run_case(case, controllers[case.controller], model, runs)
    table[case] = kpis(result)
    if case in keep:
      drives[case] = result
  return table, drives


def table_rows(table: Mapping[Case, Kpis]) -> list[str]:
  """Markdown rows: controller, then RMSE/ME in mm on each path, IACA in degrees and borders on the C-path."""
  paths = list(dict.fromkeys(case.path for case in table))
  header = "| controller | sees | steering | " + " | ".join(f"{path}: RMSE / ME [mm]" for path in paths)
  lines = [header + " | IACA [deg] | rate [deg/s] | passes the lane change |", "|---" * (len(paths) + 6) + "|"]
  groups = dict.fromkeys((case.label, case.sees, case.steering) for case in table)
  for label, sees, steering in groups:
    found = {c.path: k for c, k in table.items() if (c.label, c.sees, c.steering) == (label, sees, steering)}
    cells = [f"{1e3 * np.median(k.rmse):.1f} / {1e3 * np.median(k.me):.1f}" for k in found.values()]
    effort = " / ".join(f"{np.degrees(np.median(k.iaca)):.1f}" for k in found.values())
    rate = f"{np.degrees(max(np.median(k.steering_rate) for k in found.values())):.0f}"
    passed = f"{int(found['c'].inside.sum())} of {len(found['c'].inside)}" if "c" in found else "-"
    lines.append(f"| {label} | {sees} | {steering} | " + " | ".join(cells) + f" | {effort} | {rate} | {passed} |")
  return lines
