"""A twin driven by a recording's commands, as streams next to those that were measured, and its errors.

The recording is cut into windows of some seconds, each started from what was measured; the errors are of the same
windows. What the accelerometer says beyond the twin is also given as the force that acts on the car's mass unknown to
the twin, m (a_measured - a_twin).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import observe
from calibration.fitting.residual_channels import RESIDUALS
from calibration.fitting.windows import Cut
from qcar_twin.kinematics import road_speed
from qcar_twin.plant import SIGNALS, signal_index
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

FORCES = {"force_x": "accel_x", "force_y": "accel_y"}  # on the mass, from the specific force along the same axis
UNITS = {"force_x": "N", "force_y": "N", "steering_angle": "rad", "velocity_x": "m/s", "velocity_y": "m/s"}


def twin_streams(
  twin: Twin, theta: Array, recording: Recording, window: float = 6.0, command_shift: int = 0
) -> tuple[dict[str, Stream], dict[str, Stream]]:
  """What a twin shows on one recording, and measured minus twin at every sample time of the recording.

  Args:
    theta: parameters, (P,).
    window: s between restarts from what was measured; inf for a free run.
    command_shift: control periods by which commands act later than logged.

  Returns:
    signals on the control grid by name, `speed` that of the wheels; errors by channel in its unit, with forces [N].

  Raises:
    ValueError: the recording is too short, or driven by another kind of command than the twin.
  """
  cut = Cut(length=window, warm_up=0.0, command_shift=command_shift)
  observations = observe([recording], twin.vehicle, cut)
  segments = observations.stretches.segments
  prediction = twin.rollout(np.asarray(theta)[None], segments)
  time, rows = _in_order(prediction.signals[0], segments.offset, segments.steps, segments.period)
  shown = {name: rows[:, signal_index(name)] for name in SIGNALS}
  shown["speed"] = np.asarray(road_speed(shown["motor_speed"], twin.vehicle))
  errors = observations.measured - observations.predict(prediction)[0]
  missing: dict[str, Stream] = {}
  for name in observations.present:
    if RESIDUALS[name].model is not None and name in CHANNELS:
      mine = np.flatnonzero(observations.select(name))
      at, first = np.unique(observations.time[mine], return_index=True)
      missing[name] = Stream(at, errors[mine][first])
  forces = {
    force: Stream(missing[of].time, twin.vehicle.mass * missing[of].value)
    for force, of in FORCES.items()
    if of in missing
  }
  return {name: Stream(time, values) for name, values in shown.items() if np.isfinite(values).all()}, missing | forces


def _in_order(signals: Array, offset: Array, steps: NDArray[np.int64], period: float) -> tuple[Array, Array]:
  """Time (k,) and signals (k, 10) of all windows (S, T + 1, 10) one after the other; a window ends where the next
  begins."""
  order = np.argsort(offset, kind="stable")
  times, rows = [], []
  for place, number in enumerate(order):
    count = int(steps[number]) + 1
    if place + 1 < len(order):
      count = min(count, round(float(offset[order[place + 1]] - offset[number]) / period))
    times.append(offset[number] + period * np.arange(count))
    rows.append(signals[number, :count])
  return np.concatenate(times), np.concatenate(rows)


def sources_of(
  recording: Recording,
  twins: Mapping[str, tuple[Twin, Array]],
  window: float = 6.0,
  command_shift: int = 0,
) -> dict[str, dict[str, Stream]]:
  """`measured`, and for every twin its name and `error_` of its name, each a mapping of channels to streams."""
  sources = {"measured": dict(recording.streams)}
  for name, (twin, theta) in twins.items():
    sources[name], sources[f"error_{name}"] = twin_streams(twin, theta, recording, window, command_shift)
  return sources
