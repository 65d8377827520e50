"""A recording driven again: the measured commands into a plant, its signals with the measured ones.

Works for every `Plant`. The run starts from the measured speed and yaw rate and is never corrected.
Measured and predicted signals pass the same zero-phase moving average.
"""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.start_states import measured_start
from calibration.fitting.windows import shift_commands
from calibration.identification.step_detection import FILTER_TIME, moving_average
from qcar_twin import kinematics
from qcar_twin.bicycle.bicycle import MeasuredCar, drive_of
from qcar_twin.plant import Plant, Prediction, Segments
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

CHANNELS = {"speed": "m/s", "accel_x": "m/s^2", "yaw_rate": "rad/s", "accel_y": "m/s^2"}
PUBLISHED = {
  "speed": 0.066,
  "accel_x": 0.13,
  "yaw_rate": float(np.deg2rad(5.04)),
  "accel_y": 0.37,
}  # of the paper's oval


@dataclasses.dataclass(frozen=True, eq=False)
class FreeRun:
  """Signals of one run by channel of CHANNELS, on the control grid, NaN where the channel was not logged, (T + 1,).

  Attributes:
    time: s.  commands: of the drive in its unit and of the steering command [rad], (T, 2).
    rmse: root mean square error by channel, for the channels that were logged.
  """

  recording: str
  time: Array
  commands: Array
  measured: Mapping[str, Array]
  predicted: Mapping[str, Array]

  @property
  def rmse(self) -> dict[str, float]:
    errors = {name: self.predicted[name] - values for name, values in self.measured.items()}
    return {name: float(np.sqrt(np.nanmean(np.square(error)))) for name, error in errors.items()}


def free_run(
  plant: Plant,
  theta: Array,
  recording: Recording,
  vehicle: MeasuredCar,
  command_shift: int = 0,
  seen: Callable[[Prediction, Segments], Prediction] = lambda prediction, segments: prediction,
) -> FreeRun:
  """Drive `recording` again with parameters theta (P,) of the plant.

  Args:
    command_shift: control periods by which commands act later than logged.
    seen: a prediction as sensors show it that are not the plant's.
  """
  names = (drive_of(vehicle).channel, "steering_command")
  time, commands = recording.mean_commands(plant.period, names, getattr(vehicle, "supply_voltage", None))
  commands = shift_commands(commands, command_shift)
  held = float(commands[0, 1])
  start = measured_start(recording, float(time[0]), vehicle, held, True)  # pyright: ignore[reportArgumentType]
  segments = Segments(
    commands[None], start[None], np.array([len(commands)]), plant.period, (recording.name,), np.array([time[0]])
  )
  prediction = seen(plant.rollout(np.asarray(theta, dtype=np.float64)[None], segments), segments)
  signals = {name: prediction.channel(name)[0, 0] for name in ("motor_speed", "accel_x", "yaw_rate", "accel_y")}
  by_pose = "speed" in recording.derived  # that of the car; a sensor gives that of its wheels
  rolling = kinematics.road_speed(signals["motor_speed"], vehicle)
  signals["speed"] = prediction.channel("velocity_x")[0, 0] if by_pose else rolling
  grid = np.append(time, time[-1] + plant.period)
  raw = _measured(recording, grid, vehicle)
  logged = {name: np.isfinite(raw[name]) if name in raw else np.ones(len(grid), dtype=bool) for name in CHANNELS}
  measured = {name: _filtered(values, logged[name], plant.period) for name, values in raw.items()}
  predicted = {name: _filtered(signals[name], logged[name], plant.period) for name in CHANNELS}
  return FreeRun(recording.name, grid, commands, measured, predicted)


def _measured(recording: Recording, grid: Array, vehicle: MeasuredCar) -> dict[str, Array]:
  channels = {name: recording[name].interpolate(grid) for name in CHANNELS if name in recording}
  if "motor_speed" in recording:
    channels["speed"] = kinematics.road_speed(recording["motor_speed"].interpolate(grid), vehicle)
  return {name: channels[name] for name in CHANNELS if name in channels}


def _filtered(values: Array, logged: NDArray[np.bool_], period: float) -> Array:
  """Moving average over the rows that were logged, the same for measurement and model; NaN elsewhere."""
  result = np.full(values.shape, np.nan)
  result[logged] = moving_average(values[logged], FILTER_TIME, period)
  return result
