"""Figures of an identification, like the paper's: measured black, bicycle orange, twin blue.

Every function makes one matplotlib Figure without touching global state; `draw` writes them all as PNG.
Squares are recordings used to identify, diamonds those kept to validate.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calibration.free_run import CHANNELS, FreeRun, free_run
from calibration.identify import Identification
from calibration.longitudinal import Responses, StepError, motor_steps
from calibration.steps import PERIOD, Step, moving_average
from calibration.turns import LinearResponses, Turn, find_turns
from calibration.understeer import Understeer
from qcar_twin import kinematics
from qcar_twin.bicycle import MeasuredCar
from qcar_twin.dataset import DataSet
from qcar_twin.whole_file import whole_file

Array = NDArray[np.float64]
T = TypeVar("T")

MEASURED, TWIN, BICYCLE, BEFORE = "black", "tab:blue", "tab:orange", "grey"
MARKERS = {"identify": ("s", "identified"), "validate": ("D", "validation")}
PANELS = 4


def steady_speed(found: Identification) -> Figure:
  """Steady motor speed against voltage: recordings and the regression m_l V - b_l."""
  figure, axes = _single("motor voltage [V]", "steady motor speed [rad/s]")
  _points(axes, found.drive.steps, 1.0)
  volts = np.linspace(0.0, max(abs(s.level) for s in found.drive.steps), 50)
  speeds = np.maximum(found.drive.slope * volts - found.drive.offset, 0.0)
  axes.plot(volts, speeds, color=BICYCLE, label=f"{found.drive.slope:.4g} V - {found.drive.offset:.4g}")
  return _finished(figure)


def voltage_steps(found: Identification, steps: Sequence[Step]) -> Figure:
  """Motor speed after steps of the voltage: identification above, validation below."""

  def panel(axes: Axes, step: Step) -> None:
    responses = Responses([step])
    measured, model = responses.measured[0], responses.model(np.array(found.drive.values))[0]
    time = PERIOD * np.arange(len(measured))
    axes.plot(time, measured, color=MEASURED, label="measured")
    axes.plot(time, model, color=BICYCLE, label="bicycle")
    axes.set_title(f"{step.role}: {step.level:.3g} V", fontsize=9)

  return _panels([s for s in steps if s.steady is not None], lambda s: s.role, panel, "motor speed [rad/s]")


def understeer(characteristic: Understeer) -> Figure:
  """Understeer characteristic with its initial line and the end of the linear range."""
  figure, axes = _single("lateral acceleration [m/s$^2$]", "steering angle [deg]")
  accel = np.array(characteristic.accel)
  axes.plot(accel, np.rad2deg(characteristic.angle), color=MEASURED, label=f"measured, {characteristic.speed:.2f} m/s")
  axes.plot(accel, np.rad2deg(characteristic.slope * accel), color=BEFORE, ls="--", label="initial slope")
  axes.axvline(characteristic.linear_limit, color=BEFORE, lw=0.8)
  axes.text(
    characteristic.linear_limit, axes.get_ylim()[0], f" linear to {characteristic.linear_limit:.1f}", va="bottom"
  )
  return _finished(figure)


def steady_lateral(found: Identification, vehicle: MeasuredCar) -> Figure:
  """Steady lateral acceleration against steering angle: recordings, exact and printed steady state, turning losses."""
  assert found.lateral is not None, found.missing
  figure, axes = _single("steering angle [deg]", "steady lateral acceleration [m/s$^2$]")
  _points(axes, found.lateral.steps, 180.0 / np.pi)
  angle = np.linspace(0.0, max(abs(s.level) for s in found.lateral.steps), 50)
  speed, lengths = found.lateral.speed, (vehicle.cg_to_front, vehicle.cg_to_rear)
  exact = kinematics.lateral_acceleration_gain(speed, sum(lengths), found.lateral.understeer_gradient)
  printed = 1.0 / kinematics.steering_per_lateral_acceleration_as_printed(speed, *lengths, *found.lateral.values)
  degrees, losses = np.rad2deg(angle), 1.0 - found.losses.steering * angle**2
  axes.plot(degrees, exact * angle, color=BICYCLE, label="bicycle, exact")
  axes.plot(degrees, printed * angle, color=BEFORE, ls="--", label="bicycle, as printed")
  if found.losses.steering:
    axes.plot(degrees, exact * angle * losses, color=BICYCLE, ls=":", label="with turning losses")
  return _finished(figure)


def steering_steps(found: Identification, turns: Sequence[Turn], vehicle: MeasuredCar) -> Figure:
  """Lateral acceleration after steps of the steering: identification above, validation below."""
  assert found.lateral is not None, found.missing
  stiffness = np.array(found.lateral.values)

  def panel(axes: Axes, turn: Turn) -> None:
    shown = slice(max(turn.step.first - 20, 0), turn.step.first + 150)
    model = LinearResponses([turn], vehicle).model(stiffness)["accel_y"][0]
    axes.plot(turn.step.time[shown], moving_average(turn.signals["accel_y"])[shown], color=MEASURED, label="measured")
    axes.plot(turn.step.time[shown], model[shown], color=BICYCLE, label="bicycle")
    axes.set_title(f"{turn.step.role}: {np.rad2deg(turn.step.level):.3g} deg", fontsize=9)

  felt = [t for t in turns if "accel_y" in t.signals]
  return _panels(felt, lambda t: t.step.role, panel, "lateral acceleration [m/s$^2$]")


def driven_again(runs: Mapping[str, FreeRun], colours: Mapping[str, str]) -> Figure:
  """Speed, accelerations and yaw rate of one recording beside free runs of models by name, with their RMSE."""
  first = next(iter(runs.values()))
  names = [name for name in CHANNELS if name in first.measured]
  figure = Figure(figsize=(8.0, 2.0 * len(names)), layout="constrained")
  rows = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
  for axes, name in zip(rows, names, strict=True):
    axes.plot(first.time, first.measured[name], color=MEASURED, lw=1.0, label="measured")
    for label, run in runs.items():
      shown = f"{label}: {run.rmse[name]:.3g} {CHANNELS[name]}"
      axes.plot(run.time, run.predicted[name], color=colours[label], lw=1.0, label=shown)
    axes.set_ylabel(f"{name} [{CHANNELS[name]}]", fontsize=8)
    axes.legend(fontsize=7, loc="lower right")
  steering = rows[0].twinx()
  steering.plot(first.time[:-1], np.rad2deg(first.commands[:, 1]), color=BEFORE, ls="--", lw=0.7)
  steering.set_ylabel("steering [deg]", fontsize=8, color=BEFORE)
  rows[0].set_title(first.recording, fontsize=9)
  rows[-1].set_xlabel("time [s]")
  return figure


def draw(found: Identification, dataset: DataSet, vehicle: MeasuredCar, folder: str | os.PathLike[str]) -> list[Path]:
  """Write every figure that the data allow into `folder` as PNG; hold-out recordings stay closed."""
  folder = Path(folder)
  folder.mkdir(parents=True, exist_ok=True)
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  steps, _ = motor_steps(recordings, vehicle.gear_ratio * vehicle.wheel_radius)
  figures = {"steady_speed": steady_speed(found), "voltage_steps": voltage_steps(found, steps)}
  if found.understeer is not None:
    figures["understeer"] = understeer(found.understeer)
  if found.lateral is not None and found.lateral.steps:
    figures["steady_lateral"] = steady_lateral(found, vehicle)
    figures["steering_steps"] = steering_steps(found, find_turns(recordings, vehicle), vehicle)
  plain, theta = found.bicycle(vehicle)
  extended, _ = found.bicycle(vehicle, losses=True)
  for recording in [r for r in recordings if r.manoeuvre == "oval"]:
    runs = {"bicycle": free_run(plain, theta, recording, vehicle)}
    if extended.losses != plain.losses:
      runs["with turning losses"] = free_run(extended, theta, recording, vehicle)
    figures[recording.name] = driven_again(runs, {"bicycle": BICYCLE, "with turning losses": "peru"})
  return [_written(figure, folder / f"{name}.png") for name, figure in figures.items()]


def _single(across: str, up: str) -> tuple[Figure, Axes]:
  figure = Figure(figsize=(5.0, 4.0), layout="constrained")
  axes = figure.subplots()
  axes.set_xlabel(across)
  axes.set_ylabel(up)
  return figure, axes


def _finished(figure: Figure) -> Figure:
  figure.axes[0].grid(alpha=0.3)
  figure.axes[0].legend(fontsize=8)
  return figure


def _points(axes: Axes, steps: Sequence[StepError], scale: float) -> None:
  for role, (marker, label) in MARKERS.items():
    chosen = [s for s in steps if s.role == role and np.isfinite(s.measured)]
    level, value = [scale * abs(s.level) for s in chosen], [abs(s.measured) for s in chosen]
    axes.plot(level, value, marker, color=MEASURED, mfc="none" if role == "validate" else MEASURED, label=label)


def _panels(items: Sequence[T], role: Callable[[T], str], panel: Callable[[Axes, T], None], up: str) -> Figure:
  """Four panels: two items of each role, spread over what there is."""
  figure = Figure(figsize=(8.0, 5.0), layout="constrained")
  grid = figure.subplots(2, PANELS // 2)
  for row, name in zip(grid, MARKERS, strict=True):
    chosen = [item for item in items if role(item) == name]
    picks = np.unique(np.linspace(0, len(chosen) - 1, len(row)).astype(int)) if chosen else []
    for axes, pick in zip(row, picks, strict=False):
      panel(axes, chosen[pick])
    for axes in row:
      axes.set_visible(axes.has_data())
      axes.grid(alpha=0.3)
    row[0].set_ylabel(up, fontsize=8)
  for axes in grid[-1]:
    axes.set_xlabel("time since the step [s]", fontsize=8)
  grid[0, 0].legend(fontsize=8)
  return figure


def _written(figure: Figure, path: Path) -> Path:
  with whole_file(path) as part:
    figure.savefig(part, format="png", dpi=120)
  return path
