"""How a driver does away from where it was trained: another filter noise, other speeds, other linkages.

Everybody drives O, infinity and C with the same streams of sensor noise. A stream's mean over the three is one
observation; differences are taken stream by stream.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Controller
from agents.learning.evaluate import EvaluationCase, run_together
from agents.learning.trial import TRACKS
from agents.studies.comparison import FIRST_SEED, LEFT, PATHS, Kept, paired

Array = NDArray[np.float64]
Drivers = Callable[[float], Mapping[str, Controller]]
"""Contestants, by name, as designed for a speed, m/s."""
SPEEDS = (
  0.3,
  0.7,
  0.9,
  1.1,
  1.3,
  1.5,
)  # m/s; an agent of any speed was trained at all of these, the others at 0.5 alone
NOISES = (0.5, 2.0)
NOMINAL = "nominal, 0.5 m/s"
LINKAGES, INSIDE, OUTSIDE = 5, 0.8, 1.6  # on an ellipse of so many times the half-widths that training drew from


@dataclasses.dataclass(frozen=True)
class Result:
  """Of all drivers in one circumstance.

  Attributes:
    rmse: by driver, (streams, courses), m; LEFT for a run that left its path.
    finished: by driver, share of the runs.
  """

  rmse: dict[str, Array]
  finished: dict[str, float]


def circumstances() -> dict[str, dict[str, float]]:
  """What differs from the nominal drive at 0.5 m/s, by its name."""
  made: dict[str, dict[str, float]] = {NOMINAL: {}}
  made |= {f"filter noise x {factor:g}": {"filter_noise": factor} for factor in NOISES}
  made |= {f"{speed:g} m/s": {"speed": speed} for speed in SPEEDS}
  for word, share in (("inside", INSIDE), ("outside", OUTSIDE)):
    for angle in 2.0 * np.pi * np.arange(LINKAGES) / LINKAGES:
      gain = round(1.0 + share * TRACKS.gain_spread * float(np.cos(angle)), 3)
      offset = round(share * TRACKS.offset_spread * float(np.sin(angle)), 2)
      name = f"linkage {word}: gain {gain:g}, offset {offset:+g} deg"
      made[name] = {"steering_gain": gain, "steering_offset": offset}
  return made


def drive_all(
  drivers: Drivers,
  plant: str,
  streams: int,
  asked: Mapping[str, Mapping[str, float]],
  said: Callable[[str], None],
  unknown: tuple[str, ...] = (),
  kept: Kept | None = None,
) -> dict[str, Result]:
  """Every driver in every circumstance, with a filter that estimates the numbers `unknown` besides.

  Args:
    said: is given a line for every circumstance.
    kept: what was driven before; it is not driven again.
  """
  results = {}
  for name, changes in asked.items():
    if kept and (before := kept.get(name)):
      results[name] = Result({label: np.array(v) for label, v in before["rmse"].items()}, before["finished"])
      continue
    table = drivers(changes.get("speed", 0.5))
    given: dict[str, Any] = {"cars": streams, "seed": FIRST_SEED, "unknown": unknown, **changes}
    rows = [run_together(table, EvaluationCase(path, plant, **given)) for path in PATHS]
    rmse, finished = {}, {}
    for i, label in enumerate(table):
      runs = [row[i].kpis for row in rows]
      rmse[label] = np.stack([np.where(np.isfinite(k.rmse), k.rmse, LEFT) for k in runs], axis=1)
      finished[label] = float(np.mean([k.finished for k in runs]))
    results[name] = Result(rmse, finished)
    if kept:
      kept.keep(name, as_json({name: results[name]})[name])
    said(f"{name}: " + ", ".join(f"{k} {1e3 * v.mean():.2f} mm" for k, v in rmse.items()))
  return results


def in_markdown(results: Mapping[str, Result]) -> str:
  """Mean RMSE in mm with the share of runs that finished where not all did, and the first driver's change and its
  differences from the others, with 95 % intervals."""
  nominal = results[NOMINAL].rmse
  first, *others = nominal
  head = ["", *nominal, f"{first}: change", *(f"{first} less {other}" for other in others)]
  lines = [f"| {' | '.join(head)} |".replace("|  |", "| |"), "|---" * len(head) + "|"]
  for name, result in results.items():
    cells = [name]
    for label, rmse in result.rmse.items():
      left = f" ({100.0 * result.finished[label]:.0f} % finished)" if result.finished[label] < 1.0 else ""
      cells.append(f"{1e3 * rmse.mean():.2f}{left}")
    mine, before = (table[first].mean(axis=1) for table in (result.rmse, nominal))
    change = paired(mine[None], before[None])
    share = 100.0 / float(before.mean())
    cells.append("" if name == NOMINAL else f"{share * change.mean:+.0f} ± {share * change.half_width:.0f} %")
    for label in others:
      gap = paired(mine[None], result.rmse[label].mean(axis=1)[None])
      cells.append(f"{1e3 * gap.mean:+.2f} ± {1e3 * gap.half_width:.2f}")
    lines.append(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
  return "\n".join(lines) + "\n"


def as_json(results: Mapping[str, Result]) -> dict[str, Any]:
  """Values of every run, m."""
  return {
    name: {"rmse": {k: v.tolist() for k, v in result.rmse.items()}, "finished": result.finished}
    for name, result in results.items()
  }
