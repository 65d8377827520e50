"""Figures of the study: error on the training path over the training, indicators with their quartiles."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.plotting import PATH, contestant_colour, house, new_figure, save


@house()
def learning_figure(folder: Path, file: Path) -> bool:
  """RMSE of every evaluation during training, a line per seed; False where no training has more than one."""
  figure, ((axes,),) = new_figure(width=8.0, row_height=3.2)
  drawn: set[str] = set()
  for table in sorted(folder.glob("*/seed*/evaluations.csv")):
    with open(table, newline="", encoding="utf-8") as stream:
      rows = [(float(row["episode"]), 1e3 * float(row["rmse"])) for row in csv.DictReader(stream)]
    variant = table.parts[-3]
    if len(rows) > 1:
      label = None if variant in drawn else variant
      axes.plot(*np.array(rows).T, color=contestant_colour(variant), lw=1.0, alpha=0.8, label=label)
      drawn.add(variant)
  axes.set(xlabel="episode", ylabel="RMSE on the training path [mm]", yscale="log")
  if drawn:
    axes.legend(fontsize=8)
    save(figure, file)
  return bool(drawn)


@house()
def study_bars(table: Sequence[Mapping[str, Any]], names: Sequence[str], file: Path) -> None:
  """Medians of RMSE, ME and IACA as bars with quartiles, by path and contestant."""
  paths = list(dict.fromkeys(e["path"] for e in table))
  figure, (parts,) = new_figure(1, 3, width=13.0, row_height=3.4)
  shown = (("rmse", "RMSE [mm]", 1e3), ("me", "ME [mm]", 1e3), ("iaca", "IACA [deg]", float(np.degrees(1.0))))
  for axes, (indicator, title, scale) in zip(parts, shown, strict=True):
    for j, name in enumerate(names):
      by_path = {e["path"]: e for e in table if e["contestant"] == name and e[indicator] is not None}
      here = [i for i, path in enumerate(paths) if path in by_path]
      middle = scale * np.array([by_path[paths[i]][indicator] for i in here])
      ends = scale * np.array(
        [[np.nan if x is None else x for x in by_path[paths[i]][f"{indicator}_quartiles"]] for i in here]
      )
      place = np.array(here) + 0.85 * j / len(names)
      hatch = "//" if name.endswith("loose") else None
      axes.bar(place, middle, 0.85 / len(names), color=contestant_colour(name), hatch=hatch, edgecolor="w", label=name)
      if len(here):
        axes.errorbar(place, middle, np.abs(ends.T - middle), fmt="none", ecolor=PATH, lw=0.7)
    axes.set_xticks(np.arange(len(paths)) + 0.4, paths)
    axes.set_title(title)
  parts[0].legend(fontsize=6)
  save(figure, file)
