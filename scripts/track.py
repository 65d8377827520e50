"""Follow a path in closed loop, and report ME, RMSE and IACA with traces and a page.

qcar-twin track --path infinity --controller lq_cm --estimator fekf --plant mujoco --out OUT
"""

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np

from agents.control import controllers
from agents.control.closed_loop import Actuation, Drive, Scenario, drive
from agents.control.external_plant import ExternalPlant
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model
from agents.control.output import write_drive
from calibration.concealed.proving_ground.plant import ProvingGroundPlant
from calibration.identification.identification import Identification
from qcar_twin.command_line import run_script
from qcar_twin.estimation.observer import Observer, SensedObserver, TrueObserver
from qcar_twin.estimation.settings import ESTIMATED
from qcar_twin.plant import Plant
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.tracks import path_from

POSITIVE = ("speed", "laps", "runs")


@dataclasses.dataclass(frozen=True)
class Config:
  """One controller on one path."""

  out: Path
  """Folder for kpis.json, traces.csv and report.html."""
  path: str = "infinity"
  """Path to follow: s, o, infinity or c, random:SEED, or a CSV file of columns x and y."""
  controller: str = "lq_cm"
  """Controller: ff_fb, lq_ed, lq_cm or linear_rate."""
  version: str = "tuned"
  """Version of the controller: tuned or loose."""
  plant: Literal["mujoco", "reduced", "bicycle", "proving_ground"] = "mujoco"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, the bicycle, or the independent car."""
  estimator: Literal["fekf", "truth"] = "fekf"
  """State the controller receives: the federated filter on noisy sensors, or the truth."""
  unknown: tuple[str, ...] = ESTIMATED
  """Parameters that the filter estimates as extra states; also drive_scale. Without a name after it: none."""
  twin: str = ""
  """Twin file (TOML) of a calibration or a diagnosis; the nominal twin where empty."""
  identified: Path | None = None
  """Identification file (JSON) from which gains and filter are computed; the nominal car where not given."""
  speed: float = 0.5
  """Reference speed, m/s."""
  laps: int = 1
  """Number of laps of a closed path."""
  runs: int = 4
  """Number of cars, each with sensor noise of its own."""
  steering_gain: float = 1.0
  """Gain of the steering linkage, dimensionless; controller and filter do not know it."""
  steering_offset: float = 0.0
  """Offset of the steering linkage, deg; controller and filter do not know it."""
  seed: int = 0
  """Seed of the sensor noise."""
  quick: bool = False
  """Drive one car only."""


def plant_of(config: Config, model: Model) -> tuple[Plant, np.ndarray]:
  """What is driven, and its parameters; the independent car has none."""
  if config.plant != "proving_ground":
    return model.plant(config.plant, config.twin)
  return ExternalPlant(ProvingGroundPlant().begin, ProvingGroundPlant.period), np.empty(0)  # type: ignore[return-value]


def run(config: Config) -> tuple[Drive, Kpis]:
  """Drive, and return the drive with its indicators."""
  if config.twin and config.plant == "proving_ground":
    raise ValueError("--twin has no meaning with --plant proving_ground, a car of its own: leave one of them out")
  model = Model.of_file(config.twin)
  if config.identified:
    model = dataclasses.replace(model, theta=Identification.load(config.identified).theta)
  plant, theta = plant_of(config, model)
  count, path = 1 if config.quick else config.runs, path_from(config.path, config.laps)
  wrong = {"gain": config.steering_gain, "offset": np.radians(config.steering_offset)}
  servo = Actuation(**wrong) if config.plant == "bicycle" else Actuation(delay=0.0, lag=0.0, **wrong)
  scenario = Scenario(path, config.speed, config.laps, model.vehicle.max_steering, actuation=servo)
  numbers = controllers.entry(config.controller, config.version)
  controller = controllers.make(config.controller, numbers, model.car, config.speed, scenario.lock)
  observer: Observer = TrueObserver()
  if config.estimator == "fekf":
    suite = SensorSuite(qcar_sensors(), count, config.seed)
    observer = SensedObserver(suite, model.car, model.filter_settings(config.plant).estimating(*config.unknown))
  result = drive(plant, np.tile(theta, (count, 1)), controller, model.speed_gains, observer, scenario)
  return result, kpis(result)


def main(config: Config) -> None:
  """Write kpis.json, traces.csv and report.html, and print the indicators."""
  result, scores = run(config)
  label, vehicle = f"{config.controller} {config.version}", Model.of_file(config.twin).vehicle
  print(write_drive(config.out, label, result, scores, dataclasses.asdict(config), vehicle))


if __name__ == "__main__":
  run_script()
