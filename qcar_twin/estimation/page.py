"""What an offline run of the filter leaves behind: estimates as CSV, a summary, a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.estimation.offline import NAMES, Estimates
from qcar_twin.pages import Explorer, Line, Moment, Panel, Route, Run, Section, Table, write_page
from qcar_twin.recordings.recording import Recording

LABELS = {
  "pose_x": "x [m]",
  "pose_y": "y [m]",
  "pose_yaw": "yaw [rad]",
  "speed": "speed [m/s]",
  "sideslip_angle": "sideslip [rad]",
  "yaw_rate": "yaw rate [rad/s]",
}
_SIGMAS = 2.0  # half the width of the bands, standard deviations


def write_all(folder: Path, filtered: Sequence[tuple[Recording, Estimates]]) -> None:
  """Write NAME.csv of every recording and summary.json into a folder."""
  write_json(folder / "summary.json", {r.name: write_estimates(folder, r, estimates) for r, estimates in filtered})


def write_estimates(folder: Path, recording: Recording, estimates: Estimates) -> dict[str, object]:
  """Write NAME.csv into a folder, on the log's own clock and in its own frame, each number as it is; returns a summary.

  The filter works on time and place counted from the recording's origin; doubles resolve a date's clock to 0.2 us.
  """
  columns = estimates.columns()
  for name, taken in zip(("time", "pose_x", "pose_y"), recording.origin, strict=True):
    columns[name] = columns[name] + taken
  rows = np.column_stack(list(columns.values())).tolist()
  text = "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n"
  write_text(folder / f"{recording.name}.csv", text)
  refused = {f"{channel}: {reason}": count for (channel, reason), count in estimates.refused.items()}
  share = float(np.mean(estimates.valid))
  numbers = {
    name: dict(zip(("value", "std"), known[-1].tolist(), strict=True)) for name, known in estimates.numbers.items()
  }
  summary: dict[str, object] = {"valid": share, "not valid because": dict(estimates.reasons), "refused": refused}
  if numbers:
    summary["numbers"] = numbers
  return summary


def write_estimation(
  folder: Path, filtered: Sequence[tuple[Recording, Estimates]], rolling_radius: float, dataset: str
) -> Path:
  """Write report.html; returns its path.

  Args:
    filtered: recordings with their estimates.
    rolling_radius: m of travel per rad of the motor, to show the encoder as a speed.
    dataset: its name.
  """
  valid = np.concatenate([e.valid for _, e in filtered])
  seconds = sum(r.duration for r, _ in filtered)
  verdict = f"The filter's estimate was valid for {100.0 * valid.mean():.1f} % of {seconds:.0f} s of driving."
  subtitle = f"Data set {dataset}: {len(filtered)} recordings"
  return write_page(
    folder / "report.html", "Estimation", verdict, sections(filtered, rolling_radius), subtitle,
    tone="good" if valid.mean() > 0.99 else "partly",
  )  # fmt: skip


def sections(filtered: Sequence[tuple[Recording, Estimates]], rolling_radius: float) -> list[Section]:
  """Everything the page shows, in reading order."""
  runs = [_run(recording, estimates, rolling_radius) for recording, estimates in filtered]
  runs.sort(key=lambda run: -run.seconds)
  invalid = [Moment(r.name, a, b, f"{r.name}: not valid, {a:.1f} to {b:.1f} s") for r in runs for a, b in r.shaded]
  caption = (
    f"Estimates with a band of {_SIGMAS:g} standard deviations over what was measured. Shaded: the estimate says that"
    " it is not valid. The map shows the fused position; click it to see that moment."
  )
  parts = [Section("Estimates", "", figures=[Explorer(caption, runs, invalid, shade="not valid")])]
  rows = [(r.name, r.duration, 100.0 * float(e.valid.mean()), _told(e.reasons)) for r, e in filtered]
  refused = [(r.name, channel, reason, count) for r, e in filtered for (channel, reason), count in e.refused.items()]
  tables = [Table("Recordings", ("recording", "duration [s]", "valid [%]", "not valid because (periods)"), rows)]
  if refused:
    tables.append(Table("Rejected samples", ("recording", "channel", "why", "samples"), refused))
  known = [(r.name, name, *map(float, pair[-1])) for r, e in filtered for name, pair in e.numbers.items()]
  if known:
    titles = ("recording", "number", "value (SI)", "standard deviation (SI)")
    tables.append(Table("Estimated parameters at the end", titles, known))
  return [*parts, Section("What was used", "", tables)]


def _told(reasons: Mapping[str, int]) -> str:
  return ", ".join(f"{reason} ({count})" for reason, count in reasons.items()) or "–"


def _run(recording: Recording, estimates: Estimates, rolling_radius: float) -> Run:
  panels = []
  for name in NAMES:
    known = np.isfinite(estimates.value[name])
    value, spread = (np.where(known, v, np.nan) for v in (estimates.value[name], _SIGMAS * estimates.std[name]))
    lines = [*_measured(name, recording, rolling_radius), Line("twin", estimates.time, value, "estimate", spread)]
    panels.append(Panel(LABELS[name], lines))
  route = Route(estimates.time, estimates.value["pose_x"], estimates.value["pose_y"])
  return Run(recording.name, panels, route, shaded=_not_valid(estimates))


def _measured(name: str, recording: Recording, rolling_radius: float) -> list[Line]:
  channel, scale = ("motor_speed", rolling_radius) if name == "speed" and "motor_speed" in recording else (name, 1.0)
  if channel not in recording:
    return []
  stream = recording[channel]
  value = np.unwrap(stream.value) if name == "pose_yaw" else scale * stream.value
  return [Line("measured", stream.time, value, dots=True)]


def _not_valid(estimates: Estimates) -> list[tuple[float, float]]:
  edges: Any = np.flatnonzero(np.diff(np.concatenate([[0], ~estimates.valid, [0]])))
  ends = np.minimum(edges, len(estimates.time) - 1)
  return [(float(estimates.time[a]), float(estimates.time[b])) for a, b in zip(ends[::2], ends[1::2], strict=True)]
