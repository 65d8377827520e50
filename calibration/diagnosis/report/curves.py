"""Curves of the car as a twin has them, driven on the twin itself: drive map, steering map, front axle's side force.

Any mechanism shows in them, whatever its formula, as far as it acts on steady driving from a fresh start.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.experiment import DrivenRange
from qcar_twin.pages import Chart, line, panels
from qcar_twin.plant import START, Segments, signal_index
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

_LASTS, _PERIOD = 3.0, 0.01  # s, until driving is steady; s
_MEAN = 0.5  # s at its end that are averaged
_LEVELS = 13  # of a command


@dataclasses.dataclass(frozen=True)
class Curve:
  """One curve: its titles, the subsystems that shape it, the base twin's form, and x, y of each twin by name."""

  heading: str
  x_title: str
  y_title: str
  subsystems: tuple[str, ...]
  form: str
  points: Mapping[str, tuple[Array, Array]]


def identified_curves(twin: Twin, thetas: Mapping[str, Array], driven: DrivenRange, commands: Array) -> list[Curve]:
  """Curves of the same car with several parameter vectors.

  Args:
    thetas: whose -> (P,).
    driven: speeds and angles the recordings hold.
    commands: of all recordings, drive and steering, (k, 2): the range that is drawn.
  """
  plan: list[tuple[_Make, list[tuple[float, float, float]]]] = []
  low, high = np.quantile(commands[:, 0], [0.01, 0.99])
  if twin.vehicle.motor.steps and high - low > 1e-6:
    levels = np.linspace(low, high, _LEVELS)
    plan.append((_drive_map, [(float(u), 0.0, 0.0) for u in levels]))
  angles = np.linspace(-driven.angle, driven.angle, _LEVELS)
  if np.ptp(commands[:, 1]) > 0.02:
    plan.append((_steering_map, [(driven.slow * driven.command, float(d), driven.slow) for d in angles]))
    plan.append((_axle_curve, [(driven.fast * driven.command, float(d), driven.fast) for d in angles]))
  if not plan:
    return []
  states = np.array([state for _, own in plan for state in own])  # drive command, steering command, first speed
  steady = _steady(twin, np.stack(list(thetas.values())), states)
  curves, begin = [], 0
  for make, own in plan:
    rows = slice(begin, begin + len(own))
    curves.append(make(twin, states[rows], dict(zip(thetas, steady[:, rows], strict=True)), thetas))
    begin += len(own)
  return curves


def curve_chart(curves: Sequence[Curve], labels: Mapping[str, str]) -> Chart:
  """All of them side by side, the nominal car dotted."""
  parts = []
  for curve in curves:
    traces = []
    for who, (x, y) in curve.points.items():
      style = {"dash": "dot"} if who == "nominal" else {}
      traces.append(line(x, y, who, labels.get(who, who), style=style, hovertemplate="%{x:.3g}: %{y:.3g}"))
    parts.append((curve.heading, curve.y_title, traces))
  caption = (
    "Curves that were identified, as the twins drive them: each point is the steady end of 3 s at constant commands,"
    " from a fresh start. Dotted: the car's nominal numbers."
  )
  return panels(caption, parts, [c.x_title for c in curves], columns=len(curves), height=300)


def _steady(twin: Twin, thetas: Array, states: Array) -> Array:
  """Mean signals at the end of constant commands, (n, k, 10), before any sensor errs."""
  steps = int(round(_LASTS / _PERIOD))
  start = np.zeros((len(states), len(START)))
  start[:, START.index("velocity_x")] = states[:, 2]
  limit = twin.vehicle.max_steering
  start[:, START.index("steering_angle")] = np.clip(states[:, 1], -limit, limit)
  segments = Segments(
    commands=np.repeat(states[:, None, :2], steps, axis=1),
    start=start,
    steps=np.full(len(states), steps),
    period=_PERIOD,
    recording=("",) * len(states),
    offset=np.zeros(len(states)),
  )
  return twin.simulate(thetas, segments)[:, :, -int(_MEAN / _PERIOD) :].mean(axis=2)


_Signals = Mapping[str, Array]
_Make = Callable[[Twin, Array, _Signals, Mapping[str, Array]], Curve]


def _drive_map(twin: Twin, states: Array, steady: _Signals, thetas: Mapping[str, Array]) -> Curve:
  motor = twin.vehicle.motor
  speed = signal_index("velocity_x")
  unit = "" if motor.unit == "-" else f" [{motor.unit}]"
  return Curve(
    "Drive map: speed it settles at",
    f"{motor.channel.replace('_', ' ')}{unit}",
    "speed [m/s]",
    ("drive",),
    "motor torque a u - b omega against the driveline's friction",
    {who: (states[:, 0], s[:, speed]) for who, s in steady.items()},
  )


def _steering_map(twin: Twin, states: Array, steady: _Signals, thetas: Mapping[str, Array]) -> Curve:
  rate, speed = signal_index("yaw_rate"), signal_index("velocity_x")
  length = twin.vehicle.cg_to_front + twin.vehicle.cg_to_rear
  turned = lambda s: np.degrees(np.arctan(length * s[:, rate] / np.maximum(np.abs(s[:, speed]), 0.05)))
  return Curve(
    f"Steering map at about {states[0, 2]:.2g} m/s",
    "commanded angle [°]",
    "angle that fits the turn [°]",
    ("steering",),
    "wheels follow the command; Ackermann geometry; axles slip; shown is arctan(wheelbase yaw rate / speed)",
    {who: (np.degrees(states[:, 1]), turned(s)) for who, s in steady.items()},
  )


def _axle_curve(twin: Twin, states: Array, steady: _Signals, thetas: Mapping[str, Array]) -> Curve:
  rate, forward, left, angle = map(signal_index, ("yaw_rate", "velocity_x", "velocity_y", "steering_angle"))
  vehicle = twin.vehicle
  share = vehicle.cg_to_rear / (vehicle.cg_to_front + vehicle.cg_to_rear)
  points = {}
  for who, s in steady.items():
    mass = float(thetas[who][twin.parameters.index("mass")]) if "mass" in twin.parameters else vehicle.mass
    slip = s[:, angle] - np.arctan2(s[:, left] + vehicle.cg_to_front * s[:, rate], np.maximum(s[:, forward], 0.05))
    order = np.argsort(slip)
    points[who] = (np.degrees(slip)[order], (share * mass * s[:, forward] * s[:, rate])[order])
  return Curve(
    f"Tyre curve of the front axle, {states[0, 2]:.2g} m/s",
    "slip angle [°]",
    "side force [N]",
    ("tyre", "ground", "body"),
    "stiffness times slip, bounded by friction times load; shown is m l_r / l speed yaw rate",
    points,
  )
