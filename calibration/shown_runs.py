"""Recordings and predictions as an explorer shows them: one panel per channel, the map of where the car went."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import CHANNELS, Observations
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Line, Panel, Route, Run
from qcar_twin.recordings.channels import CHANNELS as RECORDED

Array = NDArray[np.float64]

_SPOT = 0.2  # s between places on the map
_COMMANDS = 0.05  # s between samples of commands


def runs_of(
  observations: Observations,
  predicted: Mapping[str, Array],
  labels: Mapping[str, str] | None = None,
  noise: Mapping[str, float] | None = None,
  channels: Sequence[str] = (),
  evidence: Array | None = None,
  shaded: Mapping[str, Sequence[tuple[float, float]]] | None = None,
  notes: Mapping[str, str] | None = None,
) -> list[Run]:
  """Every recording that holds values, with what was measured and what some models predict.

  Args:
    observations: M measured values.
    predicted: whose -> values, (M,), in the channels' units.
    labels: whose -> name in the legend.
    noise: standard deviation of each channel's sensor.
    channels: in the order of the panels; those that come first in CHANNELS by default.
    evidence: per value, (M,): what the map is coloured by, per second.
    shaded, notes: by name of the recording.
  """
  order = [c for c in channels if c in observations.present] or list(observations.present)
  routes = routes_of(observations, evidence)
  runs = []
  for number, name in enumerate(observations.names):
    own = observations.recording == number
    if not own.any():
      continue
    panels = _commands(observations, name)
    for channel in order:
      rows = _in_time(observations, number, channel)
      if len(rows):
        panels.append(_panel(observations, channel, rows, predicted, labels or {}, (noise or {}).get(channel, 0.0)))
    runs.append(Run(name, panels, routes.get(name), (notes or {}).get(name, ""), (shaded or {}).get(name, ())))
  return runs


def routes_of(observations: Observations, evidence: Array | None = None) -> dict[str, Route]:
  """Where the car went in each recording with a pose; the level is evidence per second, not below zero."""
  segments = observations.stretches.segments
  if segments.pose is None or not np.isfinite(segments.pose[:, :, :2]).any():
    return {}
  width = max(1, int(round(_SPOT / segments.period)))
  grid = segments.commands.shape[1] + 1
  spots = -(-grid // width)
  stretch, step = np.divmod(observations.grid_points, grid)
  spot = stretch * spots + step // width
  weight = np.zeros(len(observations)) if evidence is None else evidence
  sums = np.bincount(spot, weight, len(segments) * spots)
  places: dict[str, list[Array]] = {}
  for number in np.flatnonzero(np.bincount(spot, minlength=len(sums)) > 0):
    s, k = number // spots, min((number % spots) * width + width // 2, int(segments.steps[number // spots]))
    x, y = segments.pose[s, k, :2]
    if np.isfinite(x) and np.isfinite(y):
      time = float(segments.offset[s]) + k * segments.period
      rate = max(float(sums[number]), 0.0) / (width * segments.period)
      places.setdefault(segments.recording[s], []).append(np.array([time, x, y, rate]))
  columns = {name: np.array(of_recording).T for name, of_recording in places.items()}
  return {n: Route(c[0], c[1], c[2], c[3] if evidence is not None else None) for n, c in columns.items()}


def _in_time(observations: Observations, recording: int, channel: str) -> NDArray[np.int64]:
  rows = np.flatnonzero((observations.recording == recording) & (observations.channel == CHANNELS.index(channel)))
  return rows[np.argsort(observations.time[rows], kind="stable")]


def _panel(
  observations: Observations,
  channel: str,
  rows: NDArray[np.int64],
  predicted: Mapping[str, Array],
  labels: Mapping[str, str],
  noise: float,
) -> Panel:
  breaks = np.flatnonzero(np.diff(observations.stretch[rows])) + 1  # lines end where the simulation started again
  cut = lambda values: np.insert(values, breaks, np.nan)
  time = cut(observations.time[rows])
  lines = [Line("measured", time, cut(observations.measured[rows]))]
  lines += [Line(who, time, cut(values[rows]), labels.get(who, "")) for who, values in predicted.items()]
  return Panel(RESIDUALS[channel].axis, lines, noise)


def _commands(observations: Observations, name: str) -> list[Panel]:
  """What drove the car: command of the drive and steering."""
  segments, vehicle = observations.stretches.segments, observations.vehicle
  apart = max(1, int(round(_COMMANDS / segments.period)))
  times, values = [], []
  for s in np.flatnonzero([recording == name for recording in segments.recording]):
    steps = np.arange(0, int(segments.steps[s]), apart)
    times += [segments.offset[s] + steps * segments.period, [np.nan]]
    values += [segments.commands[s, steps], np.full((1, 2), np.nan)]
  time, command = np.concatenate(times), np.concatenate(values)
  titles = [f"{c.replace('_', ' ')} [{RECORDED[c].unit}]" for c in (vehicle.motor.channel, "steering_command")]
  return [Panel(title, [Line("note", time, command[:, k], "command")]) for k, title in enumerate(titles)]
