"""The controllers' section of the results: tables, figures, which pass the lane change."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from agents.control import figures as draw
from agents.control.interface import Controller
from agents.control.model import Model
from agents.studies.tracking_study import MISMATCHED, NOMINAL, VALIDATION, run_table, table_rows


def tracking_section(
  model: Model, controllers: Mapping[tuple[str, str], Controller], runs: int, figures: Path, quick: bool = False
) -> list[str]:
  """Markdown lines; figures are written next to it. `quick`: two controllers through the lane change on the bicycle, on
  the estimate alone."""
  paths = ("c",) if quick else VALIDATION
  families: dict[str, dict[str, Controller]] = {}
  for name, version in [("lq_cm", "tuned"), ("ff_fb", "loose")] if quick else controllers:
    families.setdefault(name, {})[version] = controllers[name, version]
  lines = [
    "## Controllers on the validation paths",
    "",
    f"0.5 m/s; {runs} runs with noise of their own where the controller sees the filter's estimate.",
    "N: steering as commanded; MIS: steering gain 0.92 and offset +1 degree that nobody knows.",
    "Numbers and origin: `agents/data/controllers.toml`.",
    "The bicycle has a servo of 20 ms delay and 40 ms lag, the twin its own.",
  ]
  conditions = [*([] if quick else [("truth", NOMINAL)]), ("fekf", NOMINAL), ("fekf", MISMATCHED)]
  for plant in ("bicycle",) if quick else ("mujoco", "bicycle"):
    table, drives = run_table(families, model, plant, paths, conditions, runs)
    shown = {case: d for case, d in drives.items() if (case.sees, case.steering) == ("fekf", MISMATCHED)}
    lines += ["", f"### {plant}", "", *table_rows(table)]
    lines += _figures(plant, table, shown, figures)
  return lines


def _figures(plant: str, table: Mapping, drives: Mapping, folder: Path) -> list[str]:
  """Paths with cross-track errors, lane change, indicators: MIS on the estimate."""
  out = []
  paths = dict.fromkeys(case.path for case in drives)
  for path in paths:
    here = {case.label: drive for case, drive in drives.items() if case.path == path}
    file = folder / f"tracking_{plant}_{path}.png"
    draw.tracking_figure(here, file)
    out.append(file)
    if path == "c":
      file = folder / f"lane_change_{plant}.png"
      draw.lane_change_figure(here, file)
      out.append(file)
  bars = {
    path: {
      case.label: tuple(float(np.median(getattr(table[case], name))) for name in ("rmse", "me", "iaca"))
      for case in drives
      if case.path == path
    }
    for path in paths
  }
  file = folder / f"indicators_{plant}.png"
  draw.indicator_figure(bars, file)
  out.append(file)
  titles = {"tracking": "paths and cross-track errors", "lane_change": "double lane change", "indicators": "indicators"}
  lines = []
  for file in out:
    title = next(text for key, text in titles.items() if file.name.startswith(key))
    lines += ["", f"![{plant}, MIS, on the estimate: {title}]({folder.name}/{file.name})"]
  return lines
