"""The page of an exam, as HTML and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.pages import Section, Table, heat_map, write_page

from .score import Result, case_row, characteristic, confusion, counts, interval, power, reliability
from .sealed import Plan

_Rows = list[tuple[str, ...]]
_NATS = (
  "Nats are of the generator's own car after absorption, in the product's unit: what a perfect model of the car would"
  " have of the effect (calibration/concealed/exam/nats.py)."
)


def tables(results: Sequence[Result]) -> list[tuple[str, tuple[str, ...], _Rows]]:
  """Title, columns and rows of all tables but the confusion's."""
  shown = lambda value: "-" if value is None else f"{value:.2f}"
  counted = lambda rows: [(said, f"{hits} of {of}", f"{hits / of:.2f}", interval(hits, of)) for said, hits, of in rows]
  return [
    ("What was counted", ("counted", "cases", "share", "95 % interval"), counted(counts(results))),
    ("Power", ("nats of the effect", "right name first", "share", "95 % interval"), counted(power(results))),
    (
      "Receiver operating characteristic",
      ("probability from which a name is claimed", "nulls accused", "singles found"),
      [(f"{level:g}", shown(false), shown(right)) for level, false, right in characteristic(results)],
    ),
    (
      "Calibration of stated probabilities",
      ("stated probability", "claims", "mean probability", "share right"),
      [(name, str(count), f"{mean:.2f}", f"{share:.2f}") for name, count, mean, share in reliability(results)],
    ),
    (
      "Cases",
      ("case", "kind", "truth", "verdict", "claims", "answer"),
      [case_row(r) for r in sorted(results, key=lambda r: r["name"])],
    ),
  ]


def write_exam(folder: Path, plan: Plan, results: Sequence[Result], command: str) -> Path:
  """Write report.html and exam.md; returns the first's path."""
  said = f"{_state(plan)}; {len(results)} of {plan.cases} cases answered; made by {command}"
  parts = [Section(title, _NATS if title == "Power" else "", [Table("", columns, rows)])
           for title, columns, rows in tables(results)]  # fmt: skip
  parts.insert(4, _confusion(results))
  write_text(folder / "exam.md", markdown_page(plan, results, command))
  return write_page(folder / "report.html", f"Exam: {plan.generator}", verdict(results), parts, said)


def markdown_page(plan: Plan, results: Sequence[Result], command: str) -> str:
  """The same as Markdown."""
  lines = [
    f"# Exam: {plan.generator}",
    "",
    f"`{command}`, {_state(plan)}: {len(results)} of {plan.cases} cases answered.",
  ]
  lines += ["", verdict(results), "", _NATS]
  listed = tables(results)
  rows, columns, table = confusion(results)
  listed.insert(
    4,
    ("Confusion matrix", ("effect of", *columns), [(r, *map(str, t)) for r, t in zip(rows, table, strict=True)]),
  )
  for title, heads, body in listed:
    lines += ["", f"## {title}", "", *markdown.table(heads, body)]
  return "\n".join(lines) + "\n"


def verdict(results: Sequence[Result]) -> str:
  """The outcome in a few sentences."""
  wanted = ("without an effect: something claimed", "one effect: right name first", "two effects: both named",
            "outside the catalogue: said so")  # fmt: skip
  said = [f"{name}, {hits} of {of} ({interval(hits, of)})" for name, hits, of in counts(results) if name in wanted]
  text = "; ".join(said)
  return f"{text[:1].upper()}{text[1:]}."


def _state(plan: Plan) -> str:
  if plan.sealed:
    return f"generator {plan.generator}, commit {plan.commit[:12]}, sealed"
  begun = f", begun at {plan.code}" if plan.code else ""
  return f"generator {plan.generator}, a trial that was not sealed{begun}"


def _confusion(results: Sequence[Result]) -> Section:
  rows, columns, table = confusion(results)
  chart = heat_map(
    "Subsystem of the first claim against the part of the car that the effect is of, in cases with at most one effect.",
    columns,
    rows,
    np.where(table > 0, table.astype(float), np.nan),
    ("first claim", "effect of", "cases"),
    (0.0, float(table.max(initial=1))),
  )
  return Section("Confusion matrix", "", figures=[chart])
