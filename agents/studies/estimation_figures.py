"""Figures of the filter for documents: positions, yaw, yaw rate, speed, sideslip; measured black, estimate blue."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from qcar_twin.estimation.offline import NAMES, Estimates
from qcar_twin.estimation.page import LABELS
from qcar_twin.plotting import MEASURED, NOISE, RULE, TWIN, house, new_figure, save
from qcar_twin.recordings.recording import Recording


@house()
def states_figure(estimates: Estimates, recording: Recording, rolling_radius: float, file: Path) -> None:
  """Each estimate with a band of two standard deviations over what was measured of it."""
  figure, parts = new_figure(3, 2, width=12.0, row_height=2.5, share_x=True)
  for axes, name in zip(parts.T.ravel(), NAMES, strict=True):
    _measured(axes, name, recording, rolling_radius)
    value, spread = estimates.value[name], 2.0 * estimates.std[name]
    good = np.isfinite(value)
    axes.plot(estimates.time[good], value[good], color=TWIN, lw=1.0, label="estimate")
    axes.fill_between(estimates.time[good], (value - spread)[good], (value + spread)[good], color=TWIN, alpha=0.2)
    _shade(axes, estimates)
    axes.set_ylabel(LABELS[name])
  parts[0, 0].legend(fontsize=8)
  for axes in parts[-1]:
    axes.set_xlabel("time [s]")
  save(figure, file)


@house()
def error_figure(time: np.ndarray, errors: Mapping[str, np.ndarray], ylabel: str, file: Path) -> None:
  """Errors of several estimators over time."""
  figure, ((axes,),) = new_figure(width=9.0, row_height=3.1)
  for name, values in errors.items():
    raw = name.startswith("lidar")
    axes.plot(time, values, lw=0.5 if raw else 0.9, color=RULE if raw else None, zorder=1 if raw else 2, label=name)
  axes.set_xlabel("time [s]")
  axes.set_ylabel(ylabel)
  axes.legend(fontsize=8)
  save(figure, file)


def _measured(axes: Axes, name: str, recording: Recording, rolling_radius: float) -> None:
  scale = 1.0
  if name == "speed" and "motor_speed" in recording.streams:
    name, scale = "motor_speed", rolling_radius
  if name not in recording.streams:
    return
  stream = recording[name]
  value = np.unwrap(stream.value) if name == "pose_yaw" else scale * stream.value
  axes.plot(stream.time, value, ".", color=MEASURED, ms=1.5, alpha=0.6, label="measured")


def _shade(axes: Axes, estimates: Estimates) -> None:
  """Grey where the estimate says that it is not valid."""
  edges = np.flatnonzero(np.diff(np.concatenate([[0], ~estimates.valid, [0]])))
  for begin, end in zip(edges[::2], edges[1::2], strict=True):
    span = estimates.time[[begin, min(end, len(estimates.time) - 1)]].tolist()
    axes.axvspan(*span, color=NOISE, lw=0)
