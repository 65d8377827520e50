"""The sections of the results on the filter where its model is not the car."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from agents.control import controllers
from agents.control.interface import Controller
from agents.control.model import Model
from agents.learning.evaluate import EvaluationCase, run_together
from agents.learning.policy_file import IMITATION, SHIPPED
from agents.studies.comparison import MISMATCHES, drivers_of
from agents.studies.filtering.consistency import consistency_table
from agents.studies.filtering.learnt_bias import TITLES as TURNS
from agents.studies.filtering.learnt_bias import held_rows
from agents.studies.filtering.mismatch_study import (
  DELAY,
  FITTED_ON,
  LAG,
  LATE,
  PLANT,
  Drives,
  Quality,
  drive_all,
  fitted,
  known_of,
  learning,
  offset_imu,
  quality,
  scenario,
  tracked,
)
from agents.studies.tracking_study import MISMATCHED, NOMINAL, VALIDATION
from qcar_twin import markdown
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings

Array = NDArray[np.float64]
SEED = 7300  # of sensors that no choice was made on
FACTORS = (2.0, 0.5)  # times the process noise
ACCEL_BIASES, GYRO_BIASES = (0.0, 0.05, 0.3), (0.003, 0.02)  # m/s^2 and rad/s, standard deviations
WALKS = ("walk_position", "walk_speed", "walk_yaw", "walk_sideslip", "walk_yaw_rate", "walk_point_velocity")
Table = dict[tuple[str, str, str], Quality]  # by filter, linkage, path
Kinds = dict[str, Callable[[str], FilterSettings]]  # settings for a linkage, by a filter's name
TITLES = ("filter", "linkage", "O", "infinity", "C", "yaw [mrad]", "sideslip [mrad]", "beyond")


def mismatch_section(model: Model, controller: Controller, count: int, quick: bool = False) -> list[str]:
  """The filter, plain, informed and learning, with every linkage; what it makes of unknown numbers."""
  base = model.filter_settings(PLANT)
  drives = drive_all(model, controller, count, SEED, (NOMINAL, MISMATCHED) if quick else (NOMINAL, MISMATCHED, LATE))
  kinds: Kinds = {
    "plain": lambda how: base,
    "informed": lambda how: known_of(base, how),
    "states": lambda how: learning(base),
  }
  table = measured(drives, kinds)
  plain, states = (100.0 * _raised(table, name, MISMATCHED, name, NOMINAL) for name in ("plain", "states"))
  return [
    "## Nominal, mismatched, late",
    "",
    f"{count} cars on each path of the twin at 0.5 m/s. N: steering as commanded. MIS: steering gain 0.92 and offset"
    f" +1 degree. Late: {1e3 * DELAY:.0f} ms of dead time and {1e3 * LAG:.0f} ms of lag besides the servo's. LQ_cm"
    " steers on the plain filter's estimate; every filter takes the same readings. Informed: the settings say what the"
    " linkage is. States: EKF_BM estimates steering gain and offset, the gyro's bias and the encoder's scale. The"
    " paths' columns are position RMSE in mm / NEES, medians of the cars; 2 is a consistent filter's NEES. Yaw and"
    " sideslip are RMSE on the worst path. Beyond is the largest share of instants beyond a stated bound.",
    "",
    *markdown.table(TITLES, _rows(table)),
    "",
    f"MIS raises the plain filter's position RMSE by up to {plain:.0f} %, the one with the states by {states:.0f} %.",
    "",
    *consistency_table(_blocks(table)),
    "",
    *_numbers_table(table),
  ]


def noise_section(model: Model, controller: Controller, count: int, quick: bool = False) -> list[str]:
  """The filter with process noise that is twice, half, or fitted on the twin's plant."""
  base = model.filter_settings(PLANT)
  drives = drive_all(model, controller, count, SEED, (NOMINAL, MISMATCHED))
  kinds: Kinds = {}
  for name, of in (("plain", lambda s: s), ("states", learning)):
    kinds[name] = lambda how, of=of: of(base)
    for factor in FACTORS:
      kinds[f"{name} x {factor:g}"] = lambda how, factor=factor, of=of: of(base.with_walks(factor))
  noise = base if quick else fitted(model, base, controller, 2)
  if not quick:
    kinds |= {"plain, fitted": lambda how: noise, "states, fitted": lambda how: learning(noise)}
  table = measured(drives, kinds)
  worst = [
    (name, how, max(_raised(table, f"{name} x {f:g}", how, name, how) for f in FACTORS))
    for name in ("plain", "states")
    for how in (NOMINAL, MISMATCHED)
  ]
  words = ", ".join(f"{name} {how} {100 * change:.0f} %" for name, how, change in worst)
  fits = ", ".join(f"{name} {getattr(noise, name):.3g}" for name in WALKS)
  lines = [
    "## Other noise",
    "",
    "The same drives and columns. The filter's process noise densities times a factor, or fitted: those under which"
    f" the fixes of other nominal drives, of the paths {' and '.join(FITTED_ON)}, are most likely.",
    "",
    *markdown.table(TITLES, _rows(table)),
    "",
    *consistency_table({key: blocks for key, blocks in _blocks(table).items() if key[0] not in ("plain", "states")}),
    "",
    f"Noise that is twice or half as large raises the position RMSE on the worst path by: {words}.",
  ]
  return lines if quick else [*lines, "", f"Fitted: {fits} (SI per sqrt(s))."]


def states_section(model: Model, controller: Controller, count: int, quick: bool = False) -> list[str]:
  """What the states are worth to a controller, and with a worse IMU."""
  base = model.filter_settings(PLANT)
  loop = [] if quick else [*_in_the_loop(model, controller, base, count), ""]
  drivers = _drivers(1 if quick else count, VALIDATION[-1:] if quick else VALIDATION)
  return ["## What the states are worth", "", *loop, *drivers, "", *_sensors(model, controller, base, count, quick)]


def measured(drives: Drives, kinds: Kinds) -> Table:
  """Every filter on every drive, by its name, linkage and path; who is informed of nothing new is left out."""
  table: Table = {}
  for name, settings in kinds.items():
    hows = [how for how in dict.fromkeys(how for _, how in drives) if (name, how) != ("informed", NOMINAL)]
    for some in [[how] for how in hows] if name == "informed" else [hows]:
      chosen = {key: oval for key, oval in drives.items() if key[1] in some}
      for (path, how), one in zip(chosen, quality(list(chosen.values()), settings(some[0])), strict=True):
        table[name, how, path] = one
  return table


def _raised(table: Table, name: str, how: str, other: str, before: str) -> float:
  """By which share a filter's position RMSE is above another's, on the worst path."""
  middle = lambda name, how, path: float(np.median(table[name, how, path].position))
  return max(middle(name, how, path) / middle(other, before, path) for path in VALIDATION) - 1.0


def _groups(table: Table) -> dict[tuple[str, str], dict[str, Quality]]:
  """Filter and linkage: by path."""
  groups: dict[tuple[str, str], dict[str, Quality]] = {}
  for (name, how, path), one in table.items():
    groups.setdefault((name, how), {})[path] = one
  return groups


def _blocks(table: Table) -> dict[tuple[str, str], list[Array]]:
  """Filter and linkage: normalised squared errors on every path."""
  return {key: [one.blocks for one in paths.values()] for key, paths in _groups(table).items()}


def _rows(table: Table) -> list[tuple[str, ...]]:
  rows = []
  for (name, how), paths in _groups(table).items():
    cells = [f"{1e3 * np.median(paths[p].position):.1f} / {np.median(paths[p].nees):.1f}" for p in VALIDATION]
    yaw, slip = (max(1e3 * float(np.median(getattr(q, of))) for q in paths.values()) for of in ("yaw", "sideslip"))
    beyond = max(100.0 * float(q.beyond.mean()) for q in paths.values())
    rows.append((name, how, *cells, f"{yaw:.1f}", f"{slip:.1f}", f"{beyond:.2f} %"))
  return rows


def _numbers_table(table: Table) -> list[str]:
  titles = ("path", "linkage", "steering gain", "steering offset [mrad]", "gyro bias [mrad/s]", "encoder scale")
  rows = []
  for (name, how, path), one in table.items():
    if name == "states":
      low, middle, high = zip(*(np.quantile(v, [0.25, 0.5, 0.75]) for v in one.numbers.values()), strict=True)
      cells = [
        f"{scale * b:.{d}f} [{scale * a:.{d}f}, {scale * c:.{d}f}]"
        for a, b, c, scale, d in zip(low, middle, high, (1.0, 1e3, 1e3, 1.0), (3, 1, 1, 3), strict=True)
      ]
      rows.append((path, how, *cells))
  return [
    "What the states are at the end, quartiles in brackets. MIS is a gain of 0.92 and an offset of 17.5 mrad."
    " What N shows is by how much the twin itself is no linear single track.",
    "",
    *markdown.table(titles, rows),
  ]


def _in_the_loop(model: Model, controller: Controller, base: FilterSettings, count: int) -> list[str]:
  """What the controller makes of it: cross-track errors with each filter in the loop."""
  kinds = [("plain", NOMINAL, base), ("states", NOMINAL, learning(base))]
  kinds += [(name, MISMATCHED, known) for name, known in (("plain", base), ("informed", known_of(base, MISMATCHED)))]
  kinds.append(("states", MISMATCHED, learning(base)))
  middle = lambda settings, path, how: np.median(tracked(model, controller, settings, path, how, count, SEED))
  rows = [
    (name, how, *(f"{1e3 * middle(settings, path, how):.1f}" for path in VALIDATION)) for name, how, settings in kinds
  ]
  return [
    "In the loop, LQ_cm: true cross-track RMSE [mm], medians of the cars.",
    "",
    *markdown.table(("filter", "linkage", "O", "infinity", "C"), rows),
  ]


def _drivers(count: int, paths: Sequence[str]) -> list[str]:
  """The shipped agents and the tuned controllers on the reduced car, with the plain filter and with the states."""
  drivers = drivers_of((SHIPPED, IMITATION), (controllers.FILE,), tuple(controllers.FAMILIES), 0.5)
  cells: dict[str, list[str]] = {label: [] for label in drivers}
  for gain, offset in MISMATCHES.values():
    for path in paths:
      cases = [
        EvaluationCase(path, "reduced", 0.5, gain, offset, count, SEED, unknown=names) for names in ((), ESTIMATED)
      ]
      for plain, states in zip(*(run_together(drivers, case) for case in cases), strict=True):
        before, after = (1e3 * float(np.mean(row.kpis.rmse)) for row in (plain, states))
        cells[plain.contestant].append(f"{before:.1f} / {after:.1f}")
  return [
    "Every driver on the reduced car with the filter in the loop: mean true cross-track RMSE [mm], plain / states. The"
    " agents have learnt with the plain filter, and its errors with it.",
    "",
    *markdown.table(
      ("driver", *(f"{path} {how}" for how in MISMATCHES for path in paths)),
      [(label, *row) for label, row in cells.items()],
    ),
    "",
    "What they hold on infinity with MIS: mean cross-track errors [mm] in left / right turns. Filter's error: estimated"
    " less true. A driver that steers by the estimate holds that at zero; one that has learnt with the plain filter"
    " holds it off by that filter's error, whatever filter it has.",
    "",
    *markdown.table(TURNS, held_rows(drivers, "infinity", *MISMATCHES[MISMATCHED], count, SEED)),
  ]


def _sensors(model: Model, controller: Controller, base: FilterSettings, count: int, quick: bool = False) -> list[str]:
  """Biases of the IMU: which of them is worth a state."""
  rows = []
  three = dataclasses.replace(learning(base), yaw_rate_bias_std=0.0)
  for what, biases in (("accelerometer", ACCEL_BIASES), ("gyro", GYRO_BIASES)):
    for bias in biases[-1:] if quick else biases:
      oval = offset_imu(model, controller, scenario(model, "c", NOMINAL), count, SEED, **{what: bias})
      plain, without, all_of = (quality([oval], settings)[0] for settings in (base, three, learning(base)))
      unit = "m/s^2" if what == "accelerometer" else "rad/s"
      cells = [f"{1e3 * np.median(q.position):.1f} / {1e3 * np.median(q.yaw):.1f}" for q in (plain, without, all_of)]
      rows.append((what, f"{bias:g} {unit}", *cells, f"{1e3 * np.median(all_of.own):.1f}"))
  titles = ("IMU", "bias, standard deviation", "plain", "states but the gyro's bias", "states", "EKF_BM alone, states")
  return [
    "Path C, N, the IMU switched on with larger biases. Cells are position RMSE in mm / yaw RMSE in mrad."
    " EKF_BM alone takes no accelerometer, so no state for the accelerometer's bias could gain more.",
    "",
    *markdown.table(titles, rows),
  ]
