"""Run the federated filter over the recordings of a data set.

Writes estimates with standard deviations as CSV, report.html and summary.json.

qcar-twin estimate --dataset DIR --out OUT [--noise-from standstill] [--fit-noise] [--unknown steering_gain]
"""

import dataclasses
from pathlib import Path

from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.identification import Identification, identify
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.command_line import run_script
from qcar_twin.estimation.engines import Engine
from qcar_twin.estimation.noise_fit import fit_noise
from qcar_twin.estimation.offline import ONBOARD, filter_recording, unheard
from qcar_twin.estimation.page import write_all, write_estimation
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings
from qcar_twin.kinematics import rolling_radius
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.sensors.noise import standstill_noise
from qcar_twin.twin.file import values_of
from qcar_twin.vehicle.vehicle import Vehicle


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
  onboard_latency: float = 0.0
  """Delay of the IMU's and encoder's time stamps after their measurement, s."""
  sharing: tuple[float, float] = (1.0, 1.0)
  """Information sharing of the lidar between EKF_BM and EKF_PM, dimensionless: 1 1 as printed, 0.5 0.5 consistent."""
  unknown: tuple[str, ...] = ESTIMATED
  """Parameters estimated as extra states; also drive_scale. Without a name after it: none, the paper's filter."""
  twin: Path | None = None
  """Twin file (TOML) from which the filter knows linkage, lags, delays and sensors."""
  engine: Engine = "batched"
  """Implementation of the Kalman filters: batched, or filterpy of the extra of that name."""
  quick: bool = False
  """Estimate the first recording only."""


def car_of(config: Config, dataset: DataSet, vehicle: Vehicle) -> SingleTrackCar:
  """The identified single track: from the file, from the data set, or nominal when that has no steps for it."""
  bicycle, theta = Bicycle(vehicle), Bicycle(vehicle).parameters.nominal
  try:
    known = Identification.load(config.identified) if config.identified else identify(dataset, vehicle=vehicle)
    bicycle, theta = known.bicycle(vehicle)
  except NotIdentifiable as error:
    print(f"nominal drive and tyres are used, the data set identifies none: {error}")
  return bicycle.car(theta)


def settings_of(config: Config, dataset: DataSet, vehicle: Vehicle) -> FilterSettings:
  """Filter settings, with what a twin tells and noise from standstill when asked for."""
  settings = FilterSettings.of_vehicle(vehicle, sharing=config.sharing)
  settings = settings.with_scores_of(dataset.recordings).estimating(*config.unknown)
  if config.twin:
    settings = settings.with_known(values_of(config.twin))
  noise = standstill_noise(dataset[config.noise_from]) if config.noise_from else {}
  for name, estimate in noise.items():
    print(f"{name}: {estimate}")
  return settings.with_noise(noise, rolling_radius(vehicle)) if noise else settings


def main(config: Config) -> None:
  """Filter every recording and write what came out."""
  dataset = DataSet.load(config.dataset)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  car, settings = car_of(config, dataset, vehicle), settings_of(config, dataset, vehicle)
  chosen = [dataset[name] for name in config.recordings] or [r for r in dataset.recordings if "pose_x" in r]
  if not chosen:
    raise ValueError(f"nothing to estimate with a pose; there are {', '.join(r.name for r in dataset.recordings)}")
  lateness = dict.fromkeys(ONBOARD, config.onboard_latency)
  if config.fit_noise:
    training = [r for r in dataset.role("identify") if "pose_x" in r]
    settings = fit_noise(training, car, settings, lateness, vehicle=vehicle)
  filtered = []
  for recording in chosen[: 1 if config.quick else None]:
    estimates = filter_recording(recording, car, settings, lateness, engine=config.engine, vehicle=vehicle)
    filtered.append((recording, estimates))
    valid = f"valid {100.0 * estimates.valid.mean():.1f} % of {recording.duration:.1f} s"
    print(*unheard(recording, vehicle), f"{recording.name}: {valid}", sep="\n")
  write_all(config.out, filtered)
  print(f"report: {write_estimation(config.out, filtered, rolling_radius(vehicle), dataset.name)}")


if __name__ == "__main__":
  run_script()
