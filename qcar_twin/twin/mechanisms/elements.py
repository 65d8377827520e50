"""Elementary responses that several mechanisms are made of: smooth kinks, lags, delays, drive force.

Pure functions of arrays with the simulations along the first axis; no mechanism is defined here.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import START, Driving, signal_index
from qcar_twin.twin.mechanisms.base import Array, Context, Model, State, Track

REFERENCE_VOLTAGE = 2.5  # V: highest steady voltage of usual runs; sizes of electrical effects are stated there
USUAL_VOLTAGE = 1.0  # V: of usual driving; what heat and charge do over a session is stated there
KINK = 1e-3  # rad, V, ...: half-width over which corners are rounded; far below what any sensor resolves
EITHER = 1.0 / 3.0  # standard deviation of a share from 0 to 1 that may be anything: all of it is three
STANDSTILL = 0.05  # m/s: below it a force that needs motion fades out


def smooth_abs(x: Array, width: float = KINK) -> Array:
  """|x| with its corner rounded: sqrt(x^2 + width^2) - width; 0 at 0."""
  return np.sqrt(x * x + width * width) - width


def ramp(x: Array, width: float = KINK) -> Array:
  """max(x, 0) with its corner rounded: x^2 / (x + width) above 0, exactly 0 below."""
  x = np.maximum(x, 0.0)
  return x * x / (x + width)


def dead_zone(x: Array, half_width: Array, width: float = KINK) -> Array:
  """sgn(x) max(|x| - half_width, 0) with its corners rounded; exactly x at half_width = 0."""
  rise, fall = x - half_width, x + half_width
  return x + 0.5 * (np.sqrt(rise * rise + width * width) - np.sqrt(fall * fall + width * width))


def polyline(x: Array, knots: Array, heights: Array) -> Array:
  """Straight lines between knots (K,), of heights (n, K), at x, (n,); held beyond the first and the last."""
  left = np.searchsorted(knots[1:-1], x, side="right")
  part = np.minimum(np.maximum((x - knots[left]) / np.diff(knots)[left], 0.0), 1.0)
  place = left + len(knots) * np.arange(len(x))
  return (1.0 - part) * heights.take(place) + part * heights.take(place + 1)


def rolling_torque(force: Array, context: Context) -> Array:
  """Torque on the motor side that stands for a force at the wheels: N -> N m, by equal power."""
  return force * rolling_radius(context.car)


def idle_voltage(context: Context) -> Array:
  """Voltage at which the motor gives no torque at its present speed (back-EMF), V, (n,)."""
  return context.motor_damping / context.torque_per_volt * context.signal("motor_speed")


def drive_force(context: Context) -> Array:
  """Force of the motor at the wheels for the logged voltage, N, (n,), before friction."""
  torque = context.torque_per_volt * (context.commands[:, 0] - idle_voltage(context))
  return torque / rolling_radius(context.car)


def backdrop(context: Context) -> Array:
  """Voltage that probably acted before a segment began, V: the first one if the car moves, none at rest."""
  speed = context.signal("velocity_x")
  return context.commands[:, 0] * np.tanh((speed / STANDSTILL) ** 2)


def scale_grip(model: Model, change: Array, stiffness_share: Array) -> None:
  """Scale the friction of the tyres by 1 + change, (n, 4), and their stiffness by a share of that, (n, 1)."""
  model.set("friction_coefficient", model.get("friction_coefficient") * np.maximum(1.0 + change, 0.05))
  stiffness = np.maximum(1.0 + stiffness_share * change, 0.05)
  for quantity in ("cornering_stiffness", "longitudinal_stiffness"):
    model.set(quantity, model.get(quantity) * stiffness)


# Lags ---------------------------------------------------------------------------------------------


def second_order(lag: Array, inertia: Array, period: float) -> State:
  """Exact transition over one period of inertia lag^2 y'' + lag y' + y = u with u held.

  `inertia` = 1 / (2 zeta)^2: 0 is a first-order lag, 0.25 critical damping, 0.5 zeta = 0.71. `lag`
  is the low-frequency delay whatever the damping. With e = y - u and w = lag y', both in the unit
  of y: e+ = a e + b w, w+ = c e + d w. lag and inertia are (n,), s and -.
  """
  steps = period / np.maximum(lag, 1e-9 * period)
  inertia = np.maximum(inertia, 1e-6)
  root = np.sqrt((1.0 - 4.0 * inertia).astype(complex))
  root = np.where(np.abs(root) < 1e-5, 1e-5, root)  # a double pole as two very close ones
  slow, fast = -2.0 / (1.0 + root), -(1.0 + root) / (2.0 * inertia)
  decay_slow, decay_fast = np.exp(slow * steps), np.exp(fast * steps)
  spread = slow - fast
  a = (slow * decay_fast - fast * decay_slow) / spread
  b = (decay_slow - decay_fast) / spread
  c = slow * fast * -b
  d = (slow * decay_slow - fast * decay_fast) / spread
  return {"a": a.real, "b": b.real, "c": c.real, "d": d.real, "inertia": inertia, "steps": steps}


def lag_step(state: State, target: Array) -> Array:
  """Advance `output` and `rate` (lag times the output's slope) by one period; mean output over that period.

  The mean is what a held command has to be to move the car as the continuous response would; it
  follows from integrating the differential equation, and is the target itself at lag = 0.
  """
  error, rate = state["output"] - target, state["rate"]
  output = target + state["a"] * error + state["b"] * rate
  new_rate = state["c"] * error + state["d"] * rate
  lost = state["inertia"] * (new_rate - rate) + (output - state["output"])
  state["output"], state["rate"] = output, new_rate
  return target - lost / state["steps"]


# Changes that come while one drives -------------------------------------------------------------------


# s of the first drop that is tried, and from each to the next: so close that each sees the next one's flank
_EARLIEST, _RATIO = 30.0, 1.9


def come(driven: Array | float, time: Array | float, suddenness: Array | float) -> Array:
  """Share of a change that has come after so many seconds of driving, 1 - exp(-(driven / time)^suddenness)."""
  exponent = suddenness * np.log(np.maximum(driven, 1e-6) / time)
  return -np.expm1(-np.exp(np.clip(exponent, -50.0, 6.0)))


def come_amid(time: float, suddenness: float, driving: Driving) -> float:
  """What of a change falls into the middle four fifths of the driving; there must be some on either side of it."""
  first, last = driving.first, driving.last
  early, late = first + 0.1 * (last - first), last - 0.1 * (last - first)
  return float(come(late, time, suddenness) - come(early, time, suddenness))


def changes_tried(driving: Driving) -> list[tuple[float, float]]:
  """Times, s, and suddenness of a fast and a slow drift, and of drops while the car was driven."""
  count = 1 + int(max(np.log(driving.last / _EARLIEST) / np.log(_RATIO), 0.0))
  drops = [(float(t), 7.0) for t in _EARLIEST * _RATIO ** np.arange(count) if t > driving.first]
  return [(60.0, 1.0), (300.0, 1.0), *drops]


# Tracks and delays ------------------------------------------------------------------------------------


def delay_line(
  delay: Array, period: float, longest: float, present: Array, before: Array, past: Array | None = None
) -> State:
  """A ring of past commands, (n, K), from the newest at `newest`, (n,), backwards, for delays up to `longest` seconds.

  What was commanded before the segment is `past`, the newest last. Where that is not known, NaN, it is taken to have
  gone from `before`, what acts now, to `present` in a straight line over the delay.
  """
  size = math.ceil(longest / period) + 2
  samples = np.maximum(delay / period, 0.0)
  age = np.arange(1, size + 1) / np.maximum(samples, 1e-9)[:, None]
  line = present[:, None] + (before - present)[:, None] * np.minimum(age, 1.0)
  if past is not None:
    known = past[:, ::-1][:, :size]
    near = line[:, : known.shape[1]]
    near[:] = np.where(np.isfinite(known), known, near)
  whole = np.minimum(np.floor(samples), size - 2)
  return {"line": line, "newest": np.zeros(len(line)), "whole": whole, "part": samples - whole}


def whole_delay_line(
  delay: Array, period: float, longest: float, present: Array, before: Array, past: Array | None = None
) -> State:
  """The same for whole periods alone; `left_of_period` is the rest of the delay."""
  line = delay_line(delay, period, longest, present, before, past)
  return line | {"part": np.zeros(len(delay))}


def drive_line(delay: Array, longest: float, context: Context) -> State:
  """The line of a drive's commands: by whole periods alone where a speed controller answers to a duty or a speed.

  It switches with a duty: a mean of two is one that it was never given, which may neither drive nor brake. A loop of
  speed pulls with all it has at a part of a step as at the whole: a mean would act for the whole period.
  """
  line = whole_delay_line if context.car.switches else delay_line
  now, past = context.commands[:, 0], told(context.before, 0)
  return line(delay, context.period, longest, now, backdrop(context), past)


def hold_drive(model: Model, delay: Array, context: Context) -> None:
  """What `drive_line` leaves of a delay, by the motor."""
  if context.car.switches:
    model.set("drive_hold", model.get("drive_hold") + left_of_period(delay, context.period))


def left_of_period(delay: Array, period: float) -> Array:
  """What a delay in s, (n,), has beyond whole periods, in periods: below 1."""
  samples = np.maximum(delay / period, 0.0)
  return samples - np.floor(samples)


def held_back(past: Array, delay: Array, period: float, whole: bool = False) -> Array:
  """Past commands, (n, K), the newest last, each so many seconds, (n,), later; NaN where nobody knows what came.

  `whole`: by whole periods alone.
  """
  samples = np.maximum(delay / period, 0.0)[:, None]
  part, place = (0.0 if whole else samples - np.floor(samples)), np.arange(past.shape[1]) - np.floor(samples)
  at = lambda i: np.where(i >= 0, np.take_along_axis(past, np.maximum(i, 0).astype(np.intp), axis=1), np.nan)
  return np.where(part > 0.0, (1.0 - part) * at(place) + part * at(place - 1), at(place))


def told(before: Array | None, column: int) -> Array | None:
  """Of past commands, (n, K, 2), one, (n, K); None where nobody knows any."""
  return None if before is None else before[..., column]


def delay_step(state: State, command: Array) -> Array:
  """Push one command, (n,), and read the delayed one.

  A delay of a part of a period mixes two neighbours: the exact mean over the period of held commands, and all that what
  answers to a mean can tell. A servo of limited rate is none such: it sets off at its full rate for a part of a step.
  """
  line, part = state["line"], state["part"]
  size = line.shape[1]
  first, flat = size * np.arange(len(line)), line.reshape(-1)
  state["newest"] = (state["newest"] - 1.0) % size
  flat[first + state["newest"].astype(np.intp)] = command
  place = (state["newest"] + state["whole"]).astype(np.intp)
  return (1.0 - part) * flat[first + place % size] + part * flat[first + (place + 1) % size]


def shifted(values: Array, samples: Array, extrapolate: bool = False) -> Array:
  """Tracks (n, T + 1) read `samples` ago, (n, 1) or (n, T + 1), by cubic convolution.

  Its slope is continuous where a straight line's is not: between two neighbours the slope in time is that of a line,
  and at a whole sample it jumps, so that a cost has a cusp there, in which a search for a delay comes to rest.
  Outside the track the end value is held, or the end slope continued where `extrapolate`.
  Source: Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. ASSP 29(6), 1981.
  """
  last = values.shape[1] - 1
  if last < 1:
    return values.copy()
  whole = np.floor(-samples).astype(np.intp)
  part, beyond = -samples - whole, int(np.abs(whole).max()) + 3
  line = _continued(values, beyond)
  if samples.shape[1] == 1:
    out = np.empty(values.shape)
    for start in np.unique(whole):
      rows: Any = whole[:, 0] == start
      rows = slice(None) if rows.all() else np.flatnonzero(rows)
      near = [line[rows, start + k : start + k + last + 1] for k in range(beyond - 1, beyond + 3)]
      out[rows] = _cubic(near, part[rows])
  else:
    left = np.arange(last + 1) + whole
    near = [np.take_along_axis(line, left + k, axis=1) for k in range(beyond - 1, beyond + 3)]
    out = _cubic(near, part)
  if extrapolate:
    return out
  for side in (slice(None, beyond), slice(-beyond, None)):  # no sample is read from farther off
    position = np.arange(last + 1)[side] - (samples if samples.shape[1] == 1 else samples[:, side])
    out[:, side] = np.where(position <= 0.0, values[:, :1], out[:, side])
    out[:, side] = np.where(position >= last, values[:, -1:], out[:, side])
  return out


def _continued(values: Array, beyond: int) -> Array:
  """Tracks (n, T + 1) with so many samples before and after, along their end slopes."""
  far = np.arange(1.0, beyond + 1)
  first, last = values[:, :1], values[:, -1:]
  before = first - far[::-1] * (values[:, 1:2] - first)
  return np.concatenate([before, values, last + far * (last - values[:, -2:-1])], axis=1)


def _cubic(near: Sequence[Array], part: Array) -> Array:
  """Between the middle two of four neighbours, at a share of the way from the second to the third."""
  before, left, right, after = near
  bend = 3.0 * (left - right) + after - before
  return left + 0.5 * part * (right - before + part * (2.0 * before - 5.0 * left + 4.0 * right - after + part * bend))


def caught_up(start: Array, rate: Array, late: Array, *states: str) -> Array:
  """Start states (n, 7) whose sensors spoke `late`, (n,) s: x(t) = y(t) + d y'(t) for the states named."""
  out = start.copy()
  for name in states:
    out[:, START.index(name)] += late * rate[:, START.index(name)]
  return out


def replaced(track: Track, **signals: Array) -> Array:
  """Signals of a track, (n, T + 1, 10), with some put in by name; a copy, unless they are its own to change."""
  shown = track.signals if track.own else track.signals.copy()
  for name, value in signals.items():
    shown[..., signal_index(name)] = value
  return shown
