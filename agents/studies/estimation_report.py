"""The filter's sections of the results: the oval, real recordings, cost."""

import dataclasses
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Controller
from agents.control.model import Model
from agents.studies import estimation_figures as draw
from agents.studies.estimation_study import (
  SIDESLIP,
  Oval,
  Track,
  angle_rmse,
  central,
  drive_oval,
  kinematic_sideslip,
  lidar_alone,
  mean_nees,
  position_rmse,
  reckoned,
  replay,
  spread,
)
from qcar_twin import markdown
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.noise_fit import fit_noise
from qcar_twin.estimation.offline import angle_error, filter_recording, position_nees
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.plant import POSITION, YAW
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.sensors.score import ScoreVariance
from qcar_twin.sensors.statistical_lidar import StatisticalLidar
from qcar_twin.sensors.suite import qcar_sensors
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
VICON_POINT = (0.115, 0.01)  # m ahead of the rear axle and to the left: what the dart's pose is of
ONBOARD = ("speed", "accel_x", "accel_y", "yaw_rate")
LATENESS = 0.05  # s, of the dart's onboard stamps


# -- the oval ------------------------------------------------------------------------------------


def oval_section(model: Model, controller: Controller, count: int, figures: Path, quick: bool = False) -> list[str]:
  """Every estimator on the same drive of the twin."""
  laps = 1 if quick else 2
  oval = drive_oval(model, "mujoco", controller, count=count, laps=laps)
  printed = replay(oval, oval.settings)
  tracks = {
    "FEKF (as printed)": printed["FEKF"],
    "FEKF (sharing 1/2, 1/2)": replay(oval, dataclasses.replace(oval.settings, sharing=(0.5, 0.5)))["FEKF"],
    "EKF_BM alone": printed["EKF_BM alone"],
    "EKF_PM alone": printed["EKF_PM alone"],
    "centralised EKF": central(oval),
    "lidar alone, held until the next fix": lidar_alone(oval),
    "dead reckoning (encoder, gyro)": reckoned(oval),
  }
  lines = [
    "## Oval at 0.5 m/s on the twin",
    "",
    f"{count} cars, {laps} laps, LQ_cm steering on the estimate. Lidar 10 Hz, 50 ms late, 8 mm per axis with 0.3 s "
    "colour, 1 % spikes of"
    " 0.5 m, 1 % lost; IMU and encoder 100 Hz. NEES of the position is 2 for a consistent filter.",
    "",
    *markdown.table(
      ("estimator", "position RMSE [mm]", "yaw RMSE [mrad]", "NEES"),
      [_row(oval, name, track) for name, track in tracks.items()],
    ),
    "",
    *_sideslip_table(oval, printed["FEKF"]),
    "",
    *_consistency_table(oval, model, controller, count),
  ]
  _oval_figure(oval, tracks, figures / "oval_errors.png")
  return [*lines, "", f"![position error of one car]({figures.name}/oval_errors.png)"]


def _row(oval: Oval, name: str, track: Track) -> tuple[str, ...]:
  yaw = spread(angle_rmse(oval, track.yaw, YAW), 1e3) if track.yaw is not None else "-"
  consistency = spread(mean_nees(oval, track)) if track.covariance is not None else "-"
  return name, spread(position_rmse(oval, track), 1e3), yaw, consistency


def _sideslip_table(oval: Oval, track: Track) -> list[str]:
  assert track.sideslip is not None
  angles = {"EKF_BM": track.sideslip} | kinematic_sideslip(oval)
  truth = np.sqrt(np.mean(oval.truth[..., SIDESLIP] ** 2))
  return [
    f"Sideslip (root mean square of the true one {1e3 * truth:.0f} mrad):",
    "",
    *markdown.table(
      ("sideslip from", "RMSE [mrad]"),
      [(name, spread(angle_rmse(oval, angle, SIDESLIP), 1e3, 2)) for name, angle in angles.items()],
    ),
  ]


def _consistency_table(oval: Oval, model: Model, controller: Controller, count: int) -> list[str]:
  """Printed and consistent fusion, with and without allowing for the lidar's colour.

  The last rows are of a lidar whose errors really are white, the case the filters are made for.
  """
  sensors = qcar_sensors() | {"lidar": StatisticalLidar(coloured=0.0)}
  white = drive_oval(model, "mujoco", controller, count=count, laps=1, seed=1, sensors=sensors)
  kinds = (("coloured", oval, 0.3), ("white", oval, 0.0), ("white, and it is white", white, 0.0))
  sharings = (("1, 1 (printed)", (1.0, 1.0)), ("1/2, 1/2", (0.5, 0.5)))
  cells = lambda drive, sharing, correlation: [
    spread(mean_nees(drive, track))
    for track in replay(
      drive, dataclasses.replace(drive.settings, sharing=sharing, lidar_correlation=correlation)
    ).values()
  ]
  chosen = [(s, k) for s in sharings for k in kinds[:2]] + [(s, kinds[2]) for s in sharings]
  rows = [
    (title, taken, *cells(drive, sharing, correlation)) for (title, sharing), (taken, drive, correlation) in chosen
  ]
  return [
    "Consistency of the fusion on the same readings:",
    "",
    *markdown.table(("sharing", "lidar taken as", "NEES fused", "NEES EKF_BM", "NEES EKF_PM"), rows),
  ]


def _oval_figure(oval: Oval, tracks: dict[str, Track], file: Path) -> None:
  errors = {
    name: 1e3 * np.hypot(*(track.position[:, 0] - oval.truth[:, 0, POSITION]).T)
    for name, track in tracks.items()
    if not name.startswith("dead")
  }
  clipped = {name: np.minimum(error, 100.0) for name, error in errors.items()}
  draw.error_figure(oval.result.time[1:], clipped, "position error [mm], cut at 100", file)


# -- real recordings -----------------------------------------------------------------------------


def at_centre(recording: Recording, vehicle: Vehicle) -> tuple[Array, Array]:
  """Times (k,) and poses of the centre of gravity (k, 3) of a dart recording; yaw unwrapped."""
  yaw = np.unwrap(recording["pose_yaw"].value)
  ahead, left = VICON_POINT[0] - vehicle.cg_to_rear, VICON_POINT[1]
  x = recording["pose_x"].value - (np.cos(yaw) * ahead - np.sin(yaw) * left)
  y = recording["pose_y"].value - (np.sin(yaw) * ahead + np.cos(yaw) * left)
  return recording["pose_x"].time, np.stack([x, y, yaw], axis=-1)


def lidar_like(recording: Recording, vehicle: Vehicle, seed: int, std: float = 0.008) -> Recording:
  """The recording with every tenth Vicon pose, made as noisy as a lidar's (m and rad)."""
  time, pose = at_centre(recording, vehicle)
  time, pose = time[::10], pose[::10] + std * np.random.default_rng(seed).standard_normal(pose[::10].shape)
  streams = dict(recording.streams)
  streams |= {name: Stream(time, pose[:, i]) for i, name in enumerate(("pose_x", "pose_y", "pose_yaw"))}
  return dataclasses.replace(recording, streams=streams)


def recorded_settings(dataset: DataSet, vehicle: Vehicle, car: SingleTrackCar, quick: bool) -> FilterSettings:
  """Noise for the dart: sensors by judgement, process noise by likelihood on recordings that are for identification."""
  named = {recording.name: recording for recording in dataset.recordings}
  bias = np.mean([[named[n][c].value.mean() for c in ("accel_x", "accel_y")] for n in ("stair_02", "stair_03")], axis=0)
  flat = ScoreVariance.between(0.0079, 0.0081, 20.0)
  settings = FilterSettings(
    position_variance=flat,
    yaw_variance=flat,
    accel_x_bias=float(bias[0]),
    accel_y_bias=float(bias[1]),
    speed_std=0.2,  # wheels slip by that much in its bends
    yaw_rate_std=0.05,
    walk_speed=1.0,
    walk_yaw_rate=5.0,
    walk_sideslip=0.5,
    walk_point_velocity=0.5,
  )
  if quick:
    return settings
  stair, ramp = (lidar_like(named[n], vehicle, 1) for n in ("stair_02", "ramp_01"))
  training = [stair.window(stair.start, stair.start + 40.0), ramp.window(ramp.start + 60.0, ramp.start + 100.0)]
  return fit_noise(training, car, settings, {name: LATENESS for name in ONBOARD})


def recorded_section(
  dataset: DataSet, vehicle: Vehicle, car: SingleTrackCar, figures: Path, quick: bool = False
) -> list[str]:
  """The filter on free driving of a real car, Vicon as truth."""
  settings = recorded_settings(dataset, vehicle, car, quick)
  titles = ("recording", "role", "estimator", "position RMSE [mm]", "yaw RMSE [mrad]", "NEES")
  free = [r for r in dataset.recordings if r.manoeuvre == "free_driving"]
  rows = [row for r in free for row in _recorded_rows(r, vehicle, car, settings, figures)]
  lines = [
    "## Real recordings: free driving of the dart",
    "",
    "Vicon is the truth, moved to the centre of gravity; every tenth pose plus 8 mm and 8 mrad of white noise is "
    "the lidar. Errors at 100 Hz from 2 s on."
    f" Onboard stamps are taken {1e3 * LATENESS:.0f} ms back. Process noise by likelihood on parts of stair_02 and "
    "ramp_01.",
    "",
    *markdown.table(titles, rows),
  ]
  used = ", ".join(
    f"{name} {getattr(settings, name):.3g}"
    for name in ("walk_speed", "walk_yaw_rate", "walk_sideslip", "walk_yaw", "walk_position", "walk_point_velocity")
  )
  return [*lines, "", f"Noise densities: {used} (SI per sqrt(s))."]


def _recorded_rows(
  recording: Recording, vehicle: Vehicle, car: SingleTrackCar, settings: FilterSettings, figures: Path
) -> list[tuple[str, ...]]:
  noisy = lidar_like(recording, vehicle, 0)
  lateness: dict[str, float] = dict.fromkeys(ONBOARD, LATENESS)
  kinds = {"printed": settings, "shared": dataclasses.replace(settings, sharing=(0.5, 0.5))}
  estimates = {name: filter_recording(noisy, car, kind, lateness) for name, kind in kinds.items()}
  main = estimates["printed"]
  time, pose = at_centre(recording, vehicle)
  late = (main.time > time[0] + 2.0) & (main.time < time[-1])
  truth = np.stack([np.interp(main.time, time, pose[:, i]) for i in range(3)], axis=-1)
  held = np.stack([noisy[name].at(main.time) for name in ("pose_x", "pose_y", "pose_yaw")], axis=-1)
  fused = {k: np.stack([e.value["pose_x"], e.value["pose_y"]], axis=-1) for k, e in estimates.items()}
  estimators = {
    "lidar held": (held[:, POSITION], held[:, YAW], None),
    "FEKF (as printed)": (fused["printed"], main.value["pose_yaw"], main.covariance),
    "FEKF (sharing 1/2, 1/2)": (fused["shared"], estimates["shared"].value["pose_yaw"], estimates["shared"].covariance),
    "EKF_BM alone": (main.bicycle, main.value["pose_yaw"], None),
    "EKF_PM alone": (main.point, None, None),
  }
  draw.states_figure(main, noisy, float(np.asarray(car.rolling_radius)), figures / f"{recording.name}_states.png")
  rows = []
  for name, (position, yaw, covariance) in estimators.items():
    error = (position - truth[:, POSITION])[late]
    rmse = np.sqrt(np.nanmean(np.sum(error**2, axis=-1)))
    turned = f"{1e3 * np.sqrt(np.nanmean(angle_error(yaw, truth[:, YAW])[late] ** 2)):.1f}" if yaw is not None else "-"
    consistent = f"{np.nanmean(position_nees(error, covariance[late])):.1f}" if covariance is not None else "-"
    rows.append((recording.name, recording.role, name, f"{1e3 * rmse:.1f}", turned, consistent))
  return rows


# -- cost ----------------------------------------------------------------------------------------


def online_cost(model: Model, latency: int, windows: int = 100, periods: int = 40) -> float:
  """Seconds per control period of the online filter: six samples, one estimate, a fix every tenth.

  The best of many short windows, which is what the code costs when nothing else is on the core.
  """
  online = FederatedFilter(model.car, model.filter_settings("mujoco"))
  online.start(0.0, (0.0, 0.0, 0.0), 0.5)
  best = np.inf
  for window in range(windows):
    begin = time.process_time()
    for k in range(window * periods + 1, (window + 1) * periods + 1):
      _one_period(online, k, latency)
    best = min(best, (time.process_time() - begin) / periods)
  return float(best)


def _one_period(online: FederatedFilter, k: int, latency: int) -> None:
  now, rate = 0.01 * k, 0.4
  online.update(now - 0.01, "motor_voltage", 0.6)
  online.update(now - 0.01, "steering_command", 0.1)
  for name, value in (("speed", 0.5), ("yaw_rate", rate), ("accel_x", 0.0), ("accel_y", 0.2)):
    online.update(now, name, value)
  if k % 10 == 0 and k > latency:
    yaw, stamp = rate * (now - 0.01 * latency), now - 0.01 * latency
    fix = 1.25 * np.sin(yaw), 1.25 * (1.0 - np.cos(yaw)), yaw, 80.0
    for name, value in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), fix, strict=True):
      online.update(stamp, name, float(value))
  online.estimate(now)


def batch_cost(model: Model, count: int, periods: int = 20, repeats: int = 25) -> float:
  """Seconds per car and control period of the vectorised filter, fixes 50 ms late."""
  best = np.inf
  for _ in range(repeats):
    batch = FederatedBatch(model.car, model.filter_settings("mujoco"), count)
    batch.start(np.zeros((count, 3)), np.full(count, 0.5))
    commands, motion, accel = (np.tile(row, (count, 1)) for row in ((0.6, 0.1), (0.5, 0.2), (0.0, 0.1)))
    fix = np.tile((0.0, 0.0, 0.0, 80.0), (count, 1))
    begin = time.process_time()
    for k in range(periods):
      batch.command(commands)
      batch.advance(motion, accel, fix if k % 10 == 5 else None, 5)
      batch.estimate()
    best = min(best, (time.process_time() - begin) / periods / count)
  return float(best)


def cost_section(model: Model, quick: bool = False) -> list[str]:
  """What an update costs on this machine, one thread; a twentieth of the windows when `quick`."""
  windows, repeats = (5, 2) if quick else (100, 25)
  online = {latency: 1e6 * online_cost(model, latency, windows) for latency in (0, 5, 10)}
  many = {count: 1e6 * batch_cost(model, count, repeats=repeats) for count in (16, 64, 256)}
  return [
    "## Cost",
    "",
    "Processor time; per 10 ms of car, sensors' samples taken in, both filters, master and report included;",
    "the best of many short windows. A late fix makes both filters go again over the periods since its stamp.",
    "",
    *markdown.table(
      ("filter", "µs per 10 ms"),
      [(f"online, one car, lidar {10 * latency} ms late", f"{value:.0f}") for latency, value in online.items()]
      + [(f"vectorised, {count} cars, per car", f"{value:.1f}") for count, value in many.items()],
    ),
  ]
