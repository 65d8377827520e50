"""The page of a checked log: what to know first, then sensors against each other, sampling, what the driving shows.

And that of a log that cannot be read as a drive yet: why, what was guessed, and every column as it is.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.fitting.observations import UNITS
from calibration.log_check.check import LogCheck, check_log, load_to_check
from calibration.log_check.log_page import log_sections
from calibration.log_check.pairs import Estimate
from calibration.progress import CHECK, StageLine
from qcar_twin.atomic_io import write_json
from qcar_twin.pages import Cell, Chart, Explorer, Line, Panel, Run, Section, Table, write_page
from qcar_twin.pages.charts import axis, packed
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.first_dataset.columns import Columns
from qcar_twin.recordings.formats import Table as Log
from qcar_twin.recordings.recording import ROLES

_DRAWN = 0.05  # s between points
_PANELS = 16  # columns that are drawn
_SPOTS = 4000  # of a role at most
_TITLES = {"spoils": "Faults that prevent a fit", "beware": "Warnings", "note": "What this log cannot show"}


def check_and_say(folder: Path, out: Path) -> LogCheck:
  """Check the data set in `folder`, write the page into `out`, print the verdict, what to know, and where the page is.

  Raises:
    RecordingError: the data set cannot be loaded.
  """
  dataset = load_to_check(folder)
  with StageLine(CHECK) as progress:
    check = check_log(dataset, progress)
  page = write_log_check(check, out)
  print(check.verdict)
  for finding in (*check.of("spoils"), *check.of("beware")):
    print(f"{finding.severity}: {finding.text}")
  print(f"page: {page}")
  return check


def write_log_check(checked: LogCheck, folder: str | os.PathLike[str]) -> Path:
  """Write check.json and check.html; returns the page's path."""
  folder = Path(folder)
  write_json(folder / "check.json", checked.document())
  dataset = checked.dataset
  seconds = sum(r.duration for r in dataset.recordings)
  subtitle = f"Data set {dataset.name}: {len(dataset.recordings)} recordings, {seconds:.0f} s"
  tone = "bad" if checked.of("spoils") else "partly" if checked.of("beware") else "good"
  return write_page(folder / "check.html", "The log, checked", checked.verdict, sections(checked), subtitle, tone=tone)


def sections(checked: LogCheck) -> list[Section]:
  """Everything the page shows, in reading order."""
  listed = [
    Section(title, "\n".join(f"* {f.text}" for f in checked.of(severity)))  # type: ignore[arg-type]
    for severity, title in _TITLES.items()
    if checked.of(severity)  # type: ignore[arg-type]
  ]
  return [*listed, *log_sections(checked), _sensors(checked), _shown(checked), _sampling(checked), _driven(checked)]


def _sensors(checked: LogCheck) -> Section:
  text = (
    "Channels that measure one motion, fitted to each other without a model of the car: compared(t) = scale ×"
    " reference(t − lag) + bias over means of short windows. Standard deviations come from leaving blocks of driving"
    " out. Where geometry alone ties them, a lag or a scale is a sensor's. Elsewhere it is also the car's (slip, roll)."
  )
  columns = (
    "motion",
    "compared",
    "with",
    "lag [ms]",
    "scale",
    "bias",
    "unit",
    "correlation",
    "left",
    "noise explains",
    "s",
  )
  rows: list[Sequence[Cell]] = []
  regimes: list[Sequence[Cell]] = []
  for c in checked.comparisons:
    sides = (" · ".join(c.motion.compared), " · ".join(c.motion.reference))
    if c.why_not:
      rows.append([c.motion.name, *sides, c.why_not, "", "", c.motion.unit, "", "", "", c.seconds])
      continue
    numbers = (c.correlation, c.residual, c.noise)
    lag = Estimate(1e3 * c.lag.value, 1e3 * c.lag.std)
    rows.append(
      [f"{c.motion.name}{' (geometry)' if c.motion.kinematic else ''}", *sides, _pm(lag), _pm(c.scale), _pm(c.bias),
       c.motion.unit, *numbers, c.seconds]
    )  # fmt: skip
    regimes += [[c.motion.name, name, _pm(e)] for name, e in c.regimes.items()]
  tables = [Table("Two sensors of one motion", columns, rows)]
  if regimes:
    tables.append(Table("Scale by how the car was driven", ("motion", "driven", "scale"), regimes))
  return Section("Sensors against each other", text, tables)


def _shown(checked: LogCheck) -> Section:
  rows = [[s.physics, s.takes, s.amount, s.unit, s.verdict] for s in checked.shown]
  text = "Physics that was not excited cannot be distinguished from its absence, whatever is fitted."
  return Section(
    "What this driving can show", text, [Table("Excitation", ("physics", "takes", "driven", "", ""), rows)]
  )


def _sampling(checked: LogCheck) -> Section:
  rows: list[Sequence[Cell]] = []
  for s in checked.samplings:
    noise = checked.noise.get(s.channel)
    rows.append(
      [s.channel, CHANNELS[s.channel].unit, s.rate, s.publishes, 100.0 * s.jitter, s.longest, s.quantum, s.values,
       noise.std if noise else None, noise.source if noise else ""]
    )  # fmt: skip
  columns = ("channel", "unit", "rate [Hz]", "new [Hz]", "jitter [%]", "longest interval [s]", "finest step",
             "values", "noise", "noise from")  # fmt: skip
  return Section("Sampling and noise", "", [Table("Channels", columns, rows)])


def _driven(checked: LogCheck) -> Section:
  recordings = checked.dataset.recordings
  channel = "motor_speed" if any("motor_speed" in r for r in recordings) else "speed"
  traces = []
  for role, colour in zip(ROLES, ("@twin", "@bicycle", "@good"), strict=True):
    driven = [r.resample(_DRAWN) for r in recordings if r.role == role and channel in r]
    if driven:
      angle = np.concatenate([c.get("steering_command", 0.0 * c["time"]) for c in driven])
      speed = np.concatenate([c[channel] for c in driven])
      apart = max(1, len(angle) // _SPOTS)
      traces.append({"type": "scatter", "mode": "markers", "x": packed(angle[::apart]), "y": packed(speed[::apart]),
                     "name": role, "marker": {"size": 3, "opacity": 0.5, "color": colour}})  # fmt: skip
  layout = {"xaxis": axis("steering command [rad]"), "yaxis": axis(f"{channel.replace('_', ' ')} [{UNITS[channel]}]")}
  caption = "Wheels' speed against commanded steering: what is judged should lie where something was fitted."
  return Section("What was driven", "", figures=[Chart(caption, traces, layout, 420)])


def _pm(e: Estimate) -> str:
  digits = 0 if not np.isfinite(e.std) or e.std <= 0.0 else max(0, 1 - int(np.floor(np.log10(e.std))))
  return f"{e.value:.{min(digits, 6)}f} ± {e.std:.{min(digits, 6)}f}"


def write_raw(logs: Sequence[Log], why: str, guesses: Sequence[str], folder: str | os.PathLike[str]) -> Path:
  """Write log.html; returns its path.

  Args:
    logs: as they were read.
    why: they cannot be read as a drive, with the cure.
    guesses: lines of [channels].
  """
  columns = Columns(logs)
  drawn = [name for name in columns.names if not columns.constant(name)][:_PANELS]
  runs = [Run(log.label, [_column(log, name) for name in drawn if name in log]) for log in logs]
  rows: list[Sequence[Cell]] = []
  for name in columns.names:
    values = columns.values(name)
    rows.append([name, len(values), float(values.min()), float(np.median(values)), float(values.max())])
  sections = [
    Section("What was guessed", "\n".join(f"* {line}" for line in guesses)),
    Section("The columns", "Against the row's number.", figures=[Explorer("Every column that changes.", runs)]),
    Section("Ranges", "", [Table("Columns", ("column", "values", "least", "median", "largest"), rows)]),
  ]
  subtitle = ", ".join(log.label for log in logs[:4])
  return write_page(Path(folder) / "log.html", "The log", f"Not readable as a drive yet: {why}", sections, subtitle)


def _column(log: Log, name: str) -> Panel:
  values = log.number(name, name)
  return Panel(name, [Line("measured", np.arange(len(values), dtype=float), values, name)])
