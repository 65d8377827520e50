"""The results page of the study, from what its jobs left in the folder; what is not there is said to be missing."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.evaluate import summary
from agents.studies.study import MISMATCH, PATHS, VARIANTS, read_rows
from agents.studies.study_figures import learning_figure, study_bars
from qcar_twin import markdown

Table = list[dict[str, Any]]
FLOOR = "linear_rate tuned"
MARGINS = (  # of the paper: path, against, indicator, change in per cent
  ("infinity", "lq_cm tuned", "rmse", -43.0),
  ("infinity", "lq_cm tuned", "me", -41.0),
  ("infinity", "lq_ed loose", "rmse", -60.0),
  ("infinity", "lq_ed loose", "me", -53.0),
  ("c", "lq_ed loose", "rmse", -31.5),
  ("c", "lq_ed loose", "me", -31.0),
  ("infinity", "ff_fb loose", "rmse", 100.0 * (1.0 / 5.9 - 1.0)),
  ("infinity", "ff_fb loose", "me", 100.0 * (1.0 / 8.3 - 1.0)),
  ("infinity", "lq_ed loose", "iaca", -19.0),
  ("c", "lq_cm tuned", "iaca", -31.0),
)


def driven(folder: Path, setting: str) -> Table:
  """Medians and quartiles of a setting's contestants, seeds of a variant together; empty where nothing was driven."""
  rows = [
    row
    for file in sorted((folder / "evaluated" / setting.replace("/", " per ")).glob("*.json"))
    for row in read_rows(file)
  ]
  return summary(rows, lambda label: label.split()[0] if label.split()[0] in VARIANTS else label)


def pick(table: Table, contestant: str, path: str) -> dict[str, Any] | None:
  """A contestant's entry on a path, or None."""
  return next((e for e in table if (e["contestant"], e["path"]) == (contestant, path)), None)


def cell(entry: dict[str, Any] | None, indicator: str, scale: float, spread: bool = True) -> str:
  """Median [quartiles]."""
  if entry is None:
    return ""
  say = lambda x: "left" if x is None else f"{scale * x:.1f}"
  low, high = entry[f"{indicator}_quartiles"]
  return say(entry[indicator]) + (f" [{say(low)}, {say(high)}]" if spread else "")


def names_of(table: Table) -> list[str]:
  """Contestants: controllers first, then variants in their order."""
  names = list(dict.fromkeys(e["contestant"] for e in table))
  return [n for n in names if n not in VARIANTS] + [n for n in VARIANTS if n in names]


def kpi_section(title: str, table: Table) -> list[str]:
  """RMSE, ME, IACA and the lane change of everybody on every path."""
  titles = [title for p in PATHS for title in (f"{p}: RMSE mm", "ME mm", "IACA deg")]
  rows = []
  for name in names_of(table):
    row = [name]
    for e in (pick(table, name, path) for path in PATHS):
      row += [cell(e, "rmse", 1e3), cell(e, "me", 1e3), cell(e, "iaca", float(np.degrees(1.0)), spread=False)]
    rows.append([*row, _passed(pick(table, name, "c"))])
  return [f"### {title}", "", *markdown.table(["", *titles, "lane change passed"], rows)]


def _passed(entry: dict[str, Any] | None) -> str:
  """Share of the runs on the C-path that stayed inside its borders."""
  return "" if entry is None else f"{100.0 * entry['inside']:.0f} %"


def change(table: Table, contestant: str, other: str, path: str, indicator: str) -> float | None:
  """Of a median against another contestant's, per cent; None where one is missing or left the path."""
  ours, theirs = pick(table, contestant, path), pick(table, other, path)
  if not ours or not theirs or ours[indicator] is None or theirs[indicator] is None:
    return None
  return 100.0 * (ours[indicator] / theirs[indicator] - 1.0)


def margin_section(nominal: Table, mismatched: Table, variants: Sequence[str]) -> list[str]:
  """The paper's margins next to ours, without and with the mismatch."""
  head = [f"{v}, {c}" for v in variants for c in ("N", "MIS")]
  rows = []
  for path, other, indicator, paper in MARGINS:
    cells = []
    for variant in variants:
      for table in (nominal, mismatched):
        moved = change(table, variant, other, path, indicator)
        cells.append("" if moved is None else f"{moved:+.0f} %{' (reached)' if moved <= paper else ''}")
    rows.append([path, other, indicator.upper(), f"{paper:+.1f} %", *cells])
  return markdown.table(["path", "against", "indicator", "paper", *head], rows)


def floor_section(nominal: Table, mismatched: Table, variants: Sequence[str]) -> list[str]:
  """RMSE against the linear rate policy's on every path."""
  head = [f"{path}, {c}" for c in ("N", "MIS") for path in PATHS]
  rows = []
  for variant in variants:
    changes = [change(table, variant, FLOOR, path, "rmse") for table in (nominal, mismatched) for path in PATHS]
    rows.append([variant, *("" if x is None else f"{x:+.0f} %" for x in changes)])
  return markdown.table(["", *head], rows)


def training_section(folder: Path) -> list[str]:
  """What the trainings took and how they went."""
  titles = (
    "variant",
    "seeds",
    "episodes",
    "wall s",
    "CPU s",
    "of it learning (wall)",
    "full episodes in a row from",
    "best on S, mm",
    "at episode",
  )
  rows = []
  for name in VARIANTS:
    results = [json.loads(f.read_text(encoding="utf-8")) for f in sorted((folder / name).glob("seed*/result.json"))]
    if results:
      rows.append([name, str(len(results)), *_training(results)])
  return [*markdown.table(titles, rows), "", *(f"* `{name}`: {variant.about}." for name, variant in VARIANTS.items())]


def _training(results: list[dict[str, Any]]) -> list[str]:
  seconds = {name: [r["seconds"].get(name, np.nan) for r in results] for name in ("total", "cpu", "learning")}
  share = np.median(np.array(seconds["learning"]) / np.array(seconds["total"]))
  full = [r["ten_full_episodes_in_a_row_at"] for r in results]
  best = [np.nan if r["best_rmse_training_path"] is None else 1e3 * r["best_rmse_training_path"] for r in results]
  spread = lambda x: f"{np.nanmedian(x):.0f} ({np.nanmin(x):.0f} to {np.nanmax(x):.0f})"
  return [
    "/".join(dict.fromkeys(str(r["episodes"]) for r in results)),
    spread(seconds["total"]),
    spread(seconds["cpu"]),
    f"{100.0 * share:.0f} %",
    ", ".join("never" if x is None else str(x) for x in full) if any(r["episodes"] for r in results) else "-",
    ", ".join("-" if np.isnan(x) else f"{x:.1f}" for x in best),
    ", ".join("-" if np.isnan(x) else str(r["best_episode"]) for x, r in zip(best, results, strict=True)),
  ]


def place_section(folder: Path, settings: Sequence[str], first: str) -> list[str]:
  """RMSE / ME medians of everybody in several settings, a block of rows per contestant; those missing are left out."""
  tables = {name: table for name in settings if (table := driven(folder, name))}
  rows = []
  for contestant in dict.fromkeys(n for t in tables.values() for n in names_of(t) if "loose" not in n):
    for name, table in tables.items():
      entries = [pick(table, contestant, path) for path in PATHS]
      if any(entries):
        cells = [f"{cell(e, 'rmse', 1e3, False)} / {cell(e, 'me', 1e3, False)}" for e in entries]
        rows.append([contestant, name, *cells, _passed(pick(table, contestant, "c"))])
  return markdown.table(["", first, *(f"{p}: RMSE / ME mm" for p in PATHS), "lane change"], rows)


def repair_section(folder: Path, plain: str, concealed: str) -> list[str]:
  """How much of the gap retraining on the repaired twin closes."""
  with_effect, without = driven(folder, concealed), driven(folder, plain)
  titles = ("path", "wide, trained on the nominal twin, car without the effect", "nominal twin", "recalibrated twin",
            "repaired twin", "gap closed")  # fmt: skip
  rows = []
  for path in PATHS:
    reference = pick(without, "wide", path)
    entries = [pick(with_effect, name, path) for name in ("wide", "recalibrated", "repaired")]
    values = [np.nan if e is None or e["rmse"] is None else e["rmse"] for e in (reference, *entries)]
    share = (values[2] - values[3]) / (values[2] - values[0]) if values[2] != values[0] else np.nan
    closed = f"{100.0 * share:.0f} %" if np.isfinite(share) else ""
    rows.append([path, *(cell(e, "rmse", 1e3) for e in (reference, *entries)), closed])
  return markdown.table(titles, rows)


def page(folder: Path, file: Path, special: Sequence[str] = ()) -> str:
  """The page as Markdown; figures go into a folder of its name next to it, whose notes.md, if there, is put first.

  Args:
    folder: of the study.  file: the page.
    special: plants of the repaired twin's comparison, without and with the effect.
  """
  nominal, mismatched = driven(folder, "N"), driven(folder, "MIS")
  variants = [name for name in ("standard", "alone", "wide") if name in names_of(nominal)]
  pictures = _figures(folder, file, nominal, mismatched)
  settings = sorted(p.name.replace(" per ", "/") for p in (folder / "evaluated").glob("*"))
  speeds = [name for name in settings if name.endswith("m/s")]
  plants = [n for n in settings if n not in ("N", "MIS", *speeds, *special)]
  gain, offset = MISMATCH
  lines = [
    "# Results: learning to track paths",
    "",
    "Tables and figures are written by `qcar-twin study --out out/study --car 4501",
    "--page docs/results/learning.md`, after `qcar-twin repair-twin --out out/study` and",
    "`qcar-twin benchmark-learning --out out/study/timings.json`; none of their numbers is typed in.",
  ]
  notes = file.with_suffix("") / "notes.md"
  lines += ["", notes.read_text(encoding="utf-8").strip()] if notes.is_file() else []
  lines += ["", "## Trainings", "", *training_section(folder), "", *pictures[:1]]
  lines += ["", "## On the twin, 0.5 m/s, federated filter on noisy sensors", ""]
  lines += [
    "Medians [quartiles] over cars with noise of their own and all seeds of a variant.",
    f"MIS: a steering gain of {gain:g} and an offset of {offset:g} deg that nobody knows.",
    "",
  ]
  lines += [*kpi_section("N", nominal), "", *kpi_section("MIS", mismatched), "", *pictures[1:]]
  lines += ["", "## The paper's margins", "", *margin_section(nominal, mismatched, variants)]
  lines += ["", f"## RMSE against the {FLOOR} policy", "", *floor_section(nominal, mismatched, variants)]
  lines += ["", "## Speeds", "", *place_section(folder, [*speeds[:1], "N", *speeds[1:]], "speed")]
  lines += ["", "## Other plants", "", *place_section(folder, ["N", *plants], "plant")]
  if special and driven(folder, special[1]):
    lines += [
      "",
      "## A repaired twin",
      "",
      f"Median RMSE [quartiles] in mm on the {special[1]}.",
      "",
      *repair_section(folder, *special),
    ]
  lines += _timings(folder)
  return "\n".join(lines) + "\n"


def _figures(folder: Path, file: Path, nominal: Table, mismatched: Table) -> list[str]:
  """Draw what can be drawn; Markdown lines."""
  pictures_at = file.with_suffix("")
  pictures_at.mkdir(parents=True, exist_ok=True)
  drawn = []
  if learning_figure(folder, pictures_at / "learning.png"):
    drawn.append(f"![Error on the training path over the training]({pictures_at.name}/learning.png)")
  for name, table in (("N", nominal), ("MIS", mismatched)):
    if table:
      study_bars(table, names_of(table), pictures_at / f"indicators_{name}.png")
      drawn.append(f"![Indicators, {name}]({pictures_at.name}/indicators_{name}.png)")
  return drawn


def _timings(folder: Path) -> list[str]:
  """Of `qcar-twin benchmark-learning`, where they were taken."""
  file = folder / "timings.json"
  if not file.is_file():
    return []
  entries = json.loads(file.read_text(encoding="utf-8"))
  return ["", "## Time", "", *(f"* {entry}" for entry in entries)]
