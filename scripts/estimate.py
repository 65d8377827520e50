"""Run the federated filter over the recordings of a data set.

Writes estimates with standard deviations as CSV, report.html and summary.json.

qcar-twin estimate --dataset DIR --out OUT [--noise-from standstill] [--fit-noise] [--engine filterpy]
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.identification import Identification, identify
from qcar_twin.atomic_io import write_json
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.command_line import run_script
from qcar_twin.estimation.engines import Engine
from qcar_twin.estimation.noise_fit import fit_noise
from qcar_twin.estimation.offline import filter_recording
from qcar_twin.estimation.output import write_estimates
from qcar_twin.estimation.page import write_estimation
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.kinematics import rolling_radius
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.sensors.noise import standstill_noise
from qcar_twin.vehicle.vehicle import Vehicle

ONBOARD = ("motor_speed", "speed", "accel_x", "accel_y", "yaw_rate")


@dataclasses.dataclass(frozen=True)
class Config:
  """Estimate position and motion offline."""

  dataset: Path
  """Folder with dataset.toml, in SI units."""
  out: Path
  """Folder for the estimates, report.html and summary.json."""
  recordings: tuple[str, ...] = ()
  """Names of recordings; all that hold a pose where not given."""
  identified: Path | None = None
  """Identification file (JSON); made from the data set where not given."""
  noise_from: str = ""
  """Name of a standstill recording from which sensor noise and biases are estimated."""
  fit_noise: bool = False
  """Fit the filter's process noise to the identification recordings with a pose; takes a minute or more."""
  onboard_lateness: float = 0.0
  """Delay of the IMU's and encoder's time stamps after their measurement, s."""
  sharing: tuple[float, float] = (1.0, 1.0)
  """Information sharing of the lidar between EKF_BM and EKF_PM, dimensionless: 1 1 as printed, 0.5 0.5 consistent."""
  engine: Engine = "batched"
  """Whose algebra filters: batched, or filterpy of the extra of that name."""
  quick: bool = False
  """Estimate the first recording only."""


def model_of(config: Config, dataset: DataSet, vehicle: Vehicle) -> tuple[Bicycle, np.ndarray]:
  """The identified bicycle: from the file, from the data set, or nominal when that has no steps to identify it from."""
  if config.identified:
    return Identification.load(config.identified).bicycle(vehicle)
  try:
    return identify(dataset, vehicle=vehicle).bicycle(vehicle)
  except NotIdentifiable as error:
    print(f"nominal drive and tyres are used, the data set identifies none: {error}")
    return Bicycle(vehicle), Bicycle(vehicle).parameters.nominal


def settings_of(config: Config, dataset: DataSet, vehicle: Vehicle) -> FilterSettings:
  """Filter settings, with noise from standstill when asked for."""
  settings = FilterSettings(sharing=config.sharing, imu_x=vehicle.imu_x, imu_y=vehicle.imu_y)
  settings = settings.with_scores_of(dataset.recordings)
  if not config.noise_from:
    return settings
  noise = standstill_noise(dataset[config.noise_from])
  for name, estimate in noise.items():
    print(f"{name}: {estimate}")
  return settings.with_noise(noise, rolling_radius(vehicle))


def main(config: Config) -> None:
  """Filter every recording and write what came out."""
  dataset = DataSet.load(config.dataset)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  bicycle, theta = model_of(config, dataset, vehicle)
  settings, radius = settings_of(config, dataset, vehicle), rolling_radius(vehicle)
  wanted = config.recordings or tuple(r.name for r in dataset.recordings if "pose_x" in r.streams)
  chosen = [r for r in dataset.recordings if r.name in wanted]
  if not chosen:
    raise ValueError(f"nothing to estimate with a pose; there are {', '.join(r.name for r in dataset.recordings)}")
  lateness: dict[str, float] = dict.fromkeys(ONBOARD, config.onboard_lateness)
  if config.fit_noise:
    settings = fit_noise([r for r in dataset.role("identify") if "pose_x" in r], bicycle.car(theta), settings, lateness)
  summary, filtered = {}, []
  for recording in chosen[: 1 if config.quick else None]:
    estimates = filter_recording(recording, bicycle.car(theta), settings, lateness, engine=config.engine)
    filtered.append((recording, estimates))
    summary[recording.name] = write_estimates(config.out, recording, estimates)
    print(f"{recording.name}: valid {100.0 * estimates.valid.mean():.1f} % of {recording.duration:.1f} s")
  write_json(config.out / "summary.json", summary)
  print(f"report: {write_estimation(config.out, filtered, radius, dataset.name)}")


if __name__ == "__main__":
  run_script()
