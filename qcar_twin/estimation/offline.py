"""A recording in, estimates with standard deviations out; and the estimates a filter must beat."""

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.engines import Engine
from qcar_twin.estimation.estimate import Estimate
from qcar_twin.estimation.federated import TAKES, FederatedFilter
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.kinematics import kinematic_sideslip_angle, wrap_angle
from qcar_twin.recordings.channels import COMMANDS
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
ONBOARD: tuple[str, ...] = ("motor_speed", "speed", "accel_x", "accel_y", "yaw_rate")
NAMES = ("pose_x", "pose_y", "pose_yaw", "speed", "sideslip_angle", "yaw_rate")


@dataclasses.dataclass(frozen=True)
class Estimates:
  """Estimates on the filter's grid, names of NAMES, SI units.

  Attributes:
    time: s, (T,).
    value, std: per name, (T,); position from the master, the rest from EKF_BM. NaN and inf before the first pose.
    bicycle, point: position of the two local filters, m, (T, 2).
    covariance: of the master's position, xx xy yy, m^2, (T, 3).
    valid: (T,).
    numbers: values and standard deviations of what EKF_BM estimates besides, per name, (T, 2).
    reasons: how many periods each reason against the estimate held.
    refused: how many samples were not used, by (channel, reason).
  """

  time: Array
  value: Mapping[str, Array]
  std: Mapping[str, Array]
  bicycle: Array
  point: Array
  covariance: Array
  valid: NDArray[np.bool_]
  numbers: Mapping[str, Array]
  reasons: Mapping[str, int]
  refused: Mapping[tuple[str, str], int]

  def columns(self) -> dict[str, Array]:
    """Everything as columns for a file."""
    out = {"time": self.time, **self.value, **{f"{name}_std": self.std[name] for name in NAMES}}
    for name, known in self.numbers.items():
      out |= {name: known[:, 0], f"{name}_std": known[:, 1]}
    return out | {"valid": self.valid.astype(np.float64)}


@dataclasses.dataclass(frozen=True)
class Event:
  """One sample on its way to the filter: measured at `stamp`, known at `arrival`, s."""

  arrival: float
  stamp: float
  channel: str
  value: float


def events_of(
  recording: Recording,
  lateness: Mapping[str, float] | None = None,
  latency: Mapping[str, float] | None = None,
  vehicle: Vehicle | None = None,
) -> list[Event]:
  """All samples the filter takes, in order of arrival.

  The filter has one slot for the drive's command, `motor_voltage`: what drives the car goes there, whatever its unit.

  Args:
    lateness: by how much a channel's recorded time is after its measurement, s: stamps are moved back.
    latency: how long after its measurement a channel arrives, s.
    vehicle: whose drive says which command the car's drive_gain is per unit of; without it, the one that was logged
      first of DRIVE_COMMANDS. A duty is then of the vehicle's supply_voltage where the battery was logged, else as it
      is.

  Raises:
    RecordingError: the recording holds the command of another kind of drive than the vehicle's.
  """
  lateness, latency = lateness or {}, latency or {}
  drive = _drive_channel(recording, vehicle)
  logged = {COMMANDS[0]: drive}  # channel of the recording for one of the filter
  channels = [name for name in TAKES if logged.get(name, name) in recording.streams]
  if "speed" in channels and "motor_speed" in channels:
    channels.remove("speed")
  events = []
  for name in channels:
    source = logged.get(name, name)
    stream = _drive_command(recording, drive, vehicle) if source == drive else recording[source]
    stamps = stream.time - lateness.get(source, 0.0)
    arrivals = stamps + latency.get(source, 0.0)
    events += [Event(*row) for row in zip(arrivals, stamps, [name] * len(stream), stream.value, strict=True)]
  return sorted(events, key=lambda event: (event.arrival, event.stamp))


def _drive_channel(recording: Recording, vehicle: Vehicle | None) -> str:
  """The channel whose unit the car's drive_gain is per."""
  logged = recording.drive_channel
  if vehicle is None:
    return logged
  wanted = vehicle.motor.channel
  if wanted not in recording and logged in recording:
    raise RecordingError(
      f"{recording.file or recording.name}: the drive's command was logged as {logged}, but {vehicle.name} is driven"
      f' by {wanted} (drive = "{vehicle.drive}"), and its drive_gain is per unit of that; correct drive in [vehicle] of'
      f" dataset.toml, or map a {wanted}"
    )
  return wanted


def missing_pose(recording: Recording) -> list[str]:
  """Channels of the pose that a recording lacks."""
  return [name for name in ("pose_x", "pose_y", "pose_yaw") if name not in recording.streams]


def unheard(recording: Recording, vehicle: Vehicle) -> list[str]:
  """A sentence for each command of the vehicle that was not logged: the filter takes it as 0 throughout."""
  missing = [name for name in (vehicle.motor.channel, "steering_command") if name not in recording]
  cure = "was not logged and is taken as 0; map it, or leave this one out"
  return [f"{recording.name}: {name} {cure}" for name in missing]


def _drive_command(recording: Recording, channel: str, vehicle: Vehicle | None) -> Stream:
  """The drive's command as drive_gain takes it; a duty as a share of the supply, as in `Recording.commands`."""
  stream, battery = recording[channel], recording.battery
  if channel != "motor_duty" or vehicle is None or battery is None:
    return stream
  later = battery.time[battery.time > stream.time[0]]  # a duty that is held acts with a voltage that goes on changing
  time = np.union1d(stream.time, later)
  return Stream(time, stream.at(time) * np.interp(time, battery.time, battery.value) / vehicle.supply_voltage)


def filter_recording(
  recording: Recording,
  car: SingleTrackCar,
  settings: FilterSettings | None = None,
  lateness: Mapping[str, float] | None = None,
  latency: Mapping[str, float] | None = None,
  engine: Engine = "batched",
  vehicle: Vehicle | None = None,
) -> Estimates:
  """Run the federated filter over a recording as if it were online, with an engine's algebra.

  Without settings the usual ones apply, with the scale of this recording's `pose_score`: to 1 where none exceeds it,
  else to 100.

  Args:
    car: its drive_gain is per unit of the command that drives the car: V, a duty, A, m/s or m/s^2.
    lateness: by how much a channel's recorded time is after its measurement, s.
    latency: how long after its measurement a channel arrives, s.
    vehicle: says by its drive which command that is, and what voltage a duty of 1 is; without it the drive's command
      that was logged is taken, a duty as it is.

  Raises:
    RecordingError: the recording holds no pose to start from, or the command of another kind of drive.
  """
  if missing := missing_pose(recording):
    raise RecordingError(
      f"recording '{recording.name}' has no {', '.join(missing)}: the filter cannot start without an absolute pose;"
      " map a lidar or motion-capture pose in dataset.toml"
    )
  settings = settings or FilterSettings().with_scores_of([recording])
  return filter_events(events_of(recording, lateness, latency, vehicle), FederatedFilter(car, settings, engine=engine))


def filter_events(events: Iterable[Event], federated: FederatedFilter) -> Estimates:
  """Feed events in order of arrival; one estimate per period."""
  events = list(events)
  period = federated.settings.period
  begin, end = min(event.stamp for event in events), max(event.arrival for event in events)
  count = int(np.ceil((end - begin) / period - 1e-6)) + 1
  times: Array = begin + period * np.arange(count, dtype=np.float64)
  rows, numbers, position = [], [], 0
  reasons: dict[str, int] = {}
  for time in times:
    while position < len(events) and events[position].arrival <= time + 1e-9:
      federated.update(events[position].stamp, events[position].channel, events[position].value)
      position += 1
    estimate = federated.estimate(float(time))
    rows.append(_row(estimate))
    numbers.append(list(federated.numbers.values()))
    for reason in estimate.reasons:
      reasons[reason] = reasons.get(reason, 0) + 1
  return _estimates(times, np.array(rows), np.array(numbers), reasons, federated)


def _row(estimate: Estimate) -> list[float]:
  std = estimate.std
  bicycle = estimate.bicycle[0][:2] if estimate.bicycle else (np.nan, np.nan)
  point = estimate.point[0][:2] if estimate.point else (np.nan, np.nan)
  named = [getattr(estimate, name) for name in NAMES] + [std[name] for name in NAMES]
  return [*named, *bicycle, *point, *estimate.covariance, float(estimate.valid)]


def _estimates(
  times: Array, rows: Array, numbers: Array, reasons: dict[str, int], federated: FederatedFilter
) -> Estimates:
  count = len(NAMES)
  value = {name: rows[:, i] for i, name in enumerate(NAMES)}
  std = {name: rows[:, count + i] for i, name in enumerate(NAMES)}
  rest = rows[:, 2 * count :]
  bicycle, point, covariance, valid = rest[:, 0:2], rest[:, 2:4], rest[:, 4:7], rest[:, 7] > 0.5
  known = {name: numbers[:, i] for i, name in enumerate(federated.numbers)}
  return Estimates(times, value, std, bicycle, point, covariance, valid, known, reasons, dict(federated.refused))


# -- what a filter must beat ---------------------------------------------------------------------


def dead_reckoning(
  start: Array, speed: Array, yaw_rate: Array, steering: Array, car: SingleTrackCar, period: float = 0.01
) -> Array:
  """Encoder and gyro integrated from a known pose, with the kinematic sideslip: x, y, yaw, (..., T, 3).

  Args:
    start: (..., 3).
    speed, yaw_rate, steering: measured, (..., T); a NaN holds the sample before it.
  """
  speed, yaw_rate = _held(speed), _held(yaw_rate)
  sideslip = kinematic_sideslip_angle(steering, car.cg_to_front, car.cg_to_rear)
  turned = np.cumsum(yaw_rate, axis=-1) * period
  yaw = start[..., 2:3] + np.concatenate([np.zeros_like(turned[..., :1]), turned[..., :-1]], axis=-1)
  course = yaw + sideslip + 0.5 * period * yaw_rate
  x = start[..., 0:1] + np.cumsum(_shifted(speed * np.cos(course)), axis=-1) * period
  y = start[..., 1:2] + np.cumsum(_shifted(speed * np.sin(course)), axis=-1) * period
  return np.stack([x, y, yaw], axis=-1)


def _shifted(rate: Array) -> Array:
  return np.concatenate([np.zeros_like(rate[..., :1]), rate[..., :-1]], axis=-1)


def _held(samples: Array) -> Array:
  """NaN replaced by the sample before it, zero where there is none."""
  index = np.where(np.isfinite(samples), np.arange(samples.shape[-1]), 0)
  held = np.take_along_axis(samples, np.maximum.accumulate(index, axis=-1), axis=-1)
  return np.nan_to_num(held)


# -- consistency ---------------------------------------------------------------------------------


def position_nees(error: Array, covariance: Array) -> Array:
  """Normalised error squared e' P^-1 e, (...), of position errors (..., 2), m, with xx, xy, yy of P (..., 3), m^2."""
  xx, xy, yy = np.moveaxis(covariance, -1, 0)
  ex, ey = error[..., 0], error[..., 1]
  return (yy * ex**2 - 2.0 * xy * ex * ey + xx * ey**2) / (xx * yy - xy**2)


def angle_error(estimate: Array, truth: Array) -> Array:
  """estimate - truth in (-pi, pi]."""
  return wrap_angle(estimate - truth)
