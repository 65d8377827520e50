"""Pages of two data sets compared, of sessions left out, and of one fit from several starts."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.diagnosis.curves.comparison import Moved
from calibration.diagnosis.curves.comparison import sentences as moves
from calibration.diagnosis.curves.left_out import LeftOut
from calibration.diagnosis.curves.naming.forms import LEVEL
from calibration.diagnosis.curves.starts import Started
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Section, Table, write_page


def write_comparison(moved: Sequence[Moved], first: str, second: str, folder: str | os.PathLike[str]) -> Path:
  """Write comparison.html; returns its path."""
  rows: list[Sequence[Cell]] = [
    (m.name, m.unit, *m.first, *m.second, m.chance, "yes" if m.there else "no") for m in moved
  ]
  columns = ("parameter", "unit", first, "± std", second, "± std", "chance", "moved")
  text = (
    "Each data set was characterised on its own, with the knots of its curves at the same commands and speeds. Chance"
    f" is how often two fits of one car differ as much; moved is what is rarer than {100 * LEVEL:.0f} % over all"
    " numbers. Deviations count a stretch of driving as one witness. Numbers that stand in for each other (a gain and a"
    " straight curve) have wide ones, and may have moved together unseen. Of a number that stopped at a bound the bound"
    " is compared, with the deviation it would have without."
  )
  section = Section("Parameter by parameter", text, [Table(f"{first} and {second}", columns, rows)])
  said = moves(moved, first, second)
  verdict = ". ".join(line.rstrip(":") for line in said[:1]) + (f": {'; '.join(said[1:])}." if said[1:] else ".")
  tone = "partly" if said[1:] else "plain"
  return write_page(Path(folder) / "comparison.html", f"{first} and {second}", verdict, [section], "", [], tone)


def write_left_out(found: Sequence[LeftOut], name: str, folder: str | os.PathLike[str]) -> Path:
  """Write sessions.html; returns its path."""
  sections = []
  for item in found:
    rows: list[Sequence[Cell]] = [
      (RESIDUALS[channel].words, RESIDUALS[channel].symbol, value, item.own.get(channel))
      for channel, value in item.mean.items()
    ]
    columns = ("channel", "unit", "with the mean trim and gain", "with its own")
    text = f"{item.recordings} recordings. " + (
      "Trim and gain are fitted to one half of them and judged on the other, both ways round."
      if item.own
      else "One recording alone can't both give a trim and judge it."
    )
    sections.append(Section(f"Session {item.session}", text, [Table("Root mean square errors", columns, rows)]))
  verdict = "Each session driven by a twin that was fitted to the others."
  return write_page(Path(folder) / "sessions.html", f"Sessions of {name}, left out in turn", verdict, sections)


def write_starts(found: Sequence[Started], name: str, folder: str | os.PathLike[str]) -> Path:
  """Write starts.html; returns its path."""
  columns = ("channel", "unit", *(f"start {k + 1}" for k in range(len(found))), "standard deviation")
  rows: list[Sequence[Cell]] = [
    ("cost where it began", "nats", *(s.began for s in found), ""),
    ("cost", "nats", *(s.cost for s in found), float(np.std([s.cost for s in found], ddof=1))),
  ]
  for channel in found[0].errors:
    errors = [s.errors[channel] for s in found]
    rows.append((RESIDUALS[channel].words, RESIDUALS[channel].symbol, *errors, float(np.std(errors, ddof=1))))
  text = "The first start is the usual one. Errors are root mean squares where nothing was fitted."
  table = Section("Costs and errors", text, [Table("", columns, rows)])
  verdict = f"The twin with free maps, fitted from {len(found)} starts."
  return write_page(Path(folder) / "starts.html", f"Starts of {name}", verdict, [table])
