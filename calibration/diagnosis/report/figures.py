"""The pictures of a diagnosis: traces with the seconds that matter, the map, evidence, errors before and after."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.locate import Location, Span
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.search.decide import Decision
from calibration.fitting.observations import CHANNELS, UNITS, Observations
from qcar_twin.plotting import BEFORE, EVIDENCE, NOISE, NOTE, RULE, TWIN, draw, new_figure, shade_noise

Array = NDArray[np.float64]

_MOMENT = 0.25  # s of driving that share one colour on the map


def traces(pool: Pool, after: Array, location: Location, most: int = 3) -> Figure | None:
  """Signals (left) and their errors (right) over time where most of the evidence is, seconds that carry it marked.

  Args:
    pool: its base is "before".
    after: whitened residual of the repaired twin, (M,), with the pool's weights.
    location: spans and channels.
    most: rows at most.
  """
  observations = pool.problem.observations
  rows = _trace_rows(location, observations, most)
  if not rows:
    return None
  factor = pool.problem.whiten(np.ones(len(observations)))
  figure, axes = new_figure(len(rows), 2, width=10.5, row_height=2.3)
  for (left, right), (recording, channel) in zip(axes, rows, strict=True):
    mine = _trace(observations, recording, channel)
    time, measured = observations.time[mine], observations.measured[mine]
    errors = {"before": pool.base.residual[mine] / factor[mine]}
    if after is not pool.base.residual:
      errors["twin"] = after[mine] / factor[mine]
    draw(left, time, measured, "measured")
    for who, error in errors.items():
      draw(left, time, measured + error, who, "repaired twin" if who == "twin" else "before")
      draw(right, time, error, who)
    shade_noise(right, pool.floor.get(channel, 0.0))
    for axis in (left, right):
      _mark(axis, location.time, recording)
    left.set_title(recording, loc="left")
    left.set_ylabel(f"{channel.replace('_', ' ')} [{UNITS[channel]}]")
    right.set_title("error; sensor noise shaded", loc="left")
  for axis in axes[-1]:
    axis.set_xlabel("time [s]")
  _legend(axes[0, 0])
  return figure


def evidence_over_time(observations: Observations, location: Location) -> Figure:
  """Cumulative evidence through all recordings in order: it climbs where the mismatch acts."""
  figure, axes = new_figure(1, 1, row_height=2.4)
  axis = axes[0, 0]
  order = np.lexsort((observations.time, observations.recording))
  recording = observations.recording[order]
  total = np.cumsum(location.evidence[order])
  clock = _driving_time(observations.time[order], recording)
  axis.plot(clock, total, color=TWIN)
  edges = np.flatnonzero(np.diff(recording)) + 1
  for start in [0, *edges]:
    axis.axvline(clock[start], color=RULE, linewidth=0.6, zorder=0)
    axis.text(clock[start], 1.0, " " + observations.names[recording[start]], rotation=90, fontsize=6.5, va="top",
              color=NOTE, transform=axis.get_xaxis_transform())  # fmt: skip
  axis.set_xlabel("driving time, all recordings in a row [s]")
  axis.set_ylabel("evidence so far [nats]")
  return figure


def drive_map(observations: Observations, location: Location) -> Figure | None:
  """Where the car drove, coloured by evidence per second; None without a pose."""
  segments = observations.stretches.segments
  if segments.pose is None or not np.isfinite(segments.pose[:, :, :2]).any():
    return None
  figure, axes = new_figure(1, 1, width=5.6, row_height=4.8)
  axis = axes[0, 0]
  lines, rates = _coloured_lines(observations, location.evidence)
  if not lines:
    return None
  top = float(np.quantile(rates, 0.98)) or 1.0
  drawn = LineCollection(lines, cmap="YlOrRd", linewidths=1.6, capstyle="round")
  drawn.set_array(np.asarray(rates))
  drawn.set_clim(0.0, max(top, 1e-9))
  axis.add_collection(drawn)
  axis.autoscale()
  axis.set_aspect("equal", adjustable="box")
  axis.set_xlabel("x [m]")
  axis.set_ylabel("y [m]")
  figure.colorbar(drawn, ax=axis, label="evidence [nats/s]", shrink=0.8)
  return figure


def ranked_evidence(decision: Decision, most: int = 14) -> Figure:
  """Bars of evidence, best first; claims in the twin's colour, what can't be told from them hatched."""
  rows = decision.ranking[:most]
  claimed = {c.mechanism for c in decision.claims}
  equal = {name for c in decision.claims for name in c.equivalent_to}
  figure, axes = new_figure(1, 1, row_height=0.24 * max(len(rows), 4) + 0.5)
  axis = axes[0, 0]
  for place, (name, nats) in enumerate(rows):
    colour = TWIN if name in claimed else BEFORE
    axis.barh(
      place, max(nats, 0.0), color=colour, height=0.75, hatch="///" if name in equal else None, edgecolor="white"
    )
    axis.text(max(nats, 0.0), place, f" {nats:.0f}", va="center", fontsize=7.5)
  axis.set_yticks(range(len(rows)), [name for name, _ in rows])
  axis.invert_yaxis()
  axis.grid(False, axis="y")
  axis.set_axisbelow(True)
  axis.set_xlabel("evidence [nats]")
  return figure


def before_and_after(fits: Mapping[str, ChannelFit]) -> Figure | None:
  """RMS error per channel before and after, in multiples of the sensor's own noise (shaded below 1)."""
  names = [n for n, f in fits.items() if np.isfinite([f.before, f.after]).all()]
  if not names:
    return None
  figure, axes = new_figure(1, 1, row_height=2.6)
  axis = axes[0, 0]
  for place, name in enumerate(names):
    fit = fits[name]
    unit = fit.noise_floor or max(fit.before, 1e-12)
    low, high = (fit.before * (1.0 + c) / unit for c in fit.ci95)
    axis.bar(place - 0.2, fit.before / unit, 0.36, color=BEFORE, label="before" if place == 0 else None)
    axis.bar(place + 0.2, fit.after / unit, 0.36, color=TWIN, label="after" if place == 0 else None)
    axis.plot([place + 0.2] * 2, [low, high], color="black", linewidth=1.0)
  axis.axhspan(0.0, 1.0, color=NOISE, zorder=0, linewidth=0.0, label="noise floor")
  axis.set_xticks(range(len(names)), [n.replace("_", "\n") for n in names])
  axis.grid(False, axis="x")
  axis.set_ylabel("error / sensor noise")
  axis.set_axisbelow(True)
  _legend(axis)
  return figure


def _trace_rows(location: Location, observations: Observations, most: int) -> list[tuple[str, str]]:
  """Pairs of recording and channel with most evidence, spread over recordings."""
  sums: dict[tuple[int, int], float] = {}
  key = observations.recording * len(CHANNELS) + observations.channel
  total = np.bincount(key, np.maximum(location.evidence, 0.0) if location.source == "residual" else location.evidence)
  for number in np.argsort(-total):
    if total[number] > 0 and len(sums) < most:
      recording, channel = divmod(int(number), len(CHANNELS))
      if sum(r == recording for r, _ in sums) < 2:
        sums[recording, channel] = float(total[number])
  return [(observations.names[r], CHANNELS[c]) for r, c in sums]


def _trace(observations: Observations, recording: str, channel: str) -> NDArray[np.int64]:
  """Rows of one channel of one recording, in order of time."""
  mine = observations.select(channel) & (observations.recording == observations.names.index(recording))
  rows = np.flatnonzero(mine)
  return rows[np.argsort(observations.time[rows], kind="stable")]


def _legend(axis: Axes) -> None:
  """Above the axes, where it covers nothing."""
  axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, fontsize=8.5, borderaxespad=0.2)


def _mark(axis: Axes, spans: Sequence[Span], recording: str) -> None:
  for span in spans:
    if span.recording == recording:
      axis.axvspan(span.start, span.end, color=EVIDENCE, linewidth=0.0, zorder=0, alpha=0.6)


def _driving_time(time: Array, recording: NDArray[np.int64]) -> Array:
  """Recording times put one behind the other, s."""
  clock, spent = np.empty(len(time)), 0.0
  for number in dict.fromkeys(recording.tolist()):
    rows = recording == number
    clock[rows] = spent + time[rows] - time[rows].min()
    spent += float(np.ptp(time[rows]))
  return clock


def _coloured_lines(observations: Observations, evidence: Array) -> tuple[list[Array], list[float]]:
  """Pieces of the path and the evidence per second in each."""
  segments = observations.stretches.segments
  assert segments.pose is not None
  grid = segments.commands.shape[1] + 1
  width = max(1, int(round(_MOMENT / segments.period)))
  segment, step = np.divmod(observations.grid_points, grid)
  per = -(-grid // width)
  moment = segment * per + step // width
  sums = np.bincount(moment, evidence, len(segments) * per)
  seen = np.bincount(moment, minlength=len(sums)) > 0
  lines, rates = [], []
  for number in np.flatnonzero(seen):
    s, first = number // per, (number % per) * width
    piece = segments.pose[s, first : min(first + width, segments.steps[s]) + 1, :2]
    if len(piece) > 1 and np.isfinite(piece).all():
      lines.append(piece)
      rates.append(max(float(sums[number]), 0.0) / (width * segments.period))
  return lines, rates
