"""The twin's likelihood near one place: slopes of all windows, compressed, and what the filter makes of them.

  readings = y(theta, starts) + C (start, force, pose error, bias) + D dtheta + white noise
  next start = end(theta, start) + A (start, force) + B dtheta

Starts, forces and errors are integrated out; what is left of residual and columns is white, so that half a sum of
squares (and half the log determinant) is minus a log likelihood. Equations: docs/likelihood.md.
"""

import copy
import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.residual_channels import POSE
from calibration.likelihood.body_force import FORCES
from calibration.likelihood.filter import Chain, Filtered, smooth, whiten
from calibration.likelihood.noise import BIASED, Noise
from calibration.likelihood.readings import EVERY, Readings
from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import MOTION
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

# moves over which slopes are taken: speeds [m/s], yaw rate [rad/s], place [m], heading [rad]; forces [N, N, N m]
_MOVES = {"velocity_x": 0.004, "motor_speed": 0.004, "velocity_y": 0.004, "yaw_rate": 0.02, "pose_x": 0.01,
          "pose_y": 0.01, "pose_yaw": 0.01}  # fmt: skip
_PUSHES = np.array([0.3, 0.3, 0.02])
# standard deviations of a chain's first start about what was measured, in the same units
_BEGUN = np.array([0.3, 0.3, 0.3, 0.5, 0.1, 0.1, 0.1])
# what a window's end errs by beyond the forces, as standard deviations: rounding, far below what any sensor resolves
_LEAK = np.array([3e-4, 3e-4, 3e-4, 1e-3, 1e-4, 1e-4, 1e-4])
_WILDEST = 200.0  # standard deviations that one reading may move by in a slope


@dataclasses.dataclass(frozen=True)
class Whitened:
  """Half the sum of squares of independent unit-variance numbers is minus the log likelihood.

  Attributes:
    innovation, rest: residual and columns as filter and compression leave them, (J, n, 1 + p), (J, m', 1 + p).
    half_log: half the log determinant.
  """

  innovation: Array
  rest: Array
  half_log: float

  @property
  def cost(self) -> float:
    """Minus the log likelihood up to a constant."""
    return 0.5 * float(np.sum(self.innovation[..., 0] ** 2) + np.sum(self.rest[..., 0] ** 2)) + self.half_log

  def rows(self, column: slice | int = slice(None)) -> Array:
    """Of every window, innovation and rest beside each other, (J, n + m', ...)."""
    return np.concatenate([self.innovation[..., column], self.rest[..., column]], axis=1)


class Place:
  """Slopes at parameters theta (P,) and starts (J, 7).

  Args:
    twin: on the reduced car, with BodyForce among its mechanisms.
    readings: what was measured.  noise: of the sensors; the fitted part may change later.
  """

  def __init__(self, twin: Twin, readings: Readings, noise: Noise, theta: Array, starts: Array):
    self.twin, self.readings, self.noise, self.theta, self.starts = twin, readings, noise, theta, starts
    radius = rolling_radius(twin.vehicle)
    unit = np.array([1.0 / radius if name == "motor_speed" else 1.0 for name in MOTION])
    self.prior, self.leak = (_BEGUN * unit) ** 2, (_LEAK * unit) ** 2
    speed = starts[:, 0]
    self._speed, self._load = speed, self._loads()
    self.biased = [name for name in BIASED if name in readings.channels]
    self._slopes(np.array([_MOVES[name] for name in MOTION]) * unit)
    self._weigh(noise)

  def under(self, noise: Noise) -> "Place":
    """The same place with other white noise."""
    made = copy.copy(self)
    made._weigh(noise)
    return made

  def _loads(self) -> Array:
    """Force of the tyres on the car in each window by its accelerometers, N, (J,); 0 without them."""
    readings, total = self.readings, np.zeros(len(self.readings))
    for name in ("accel_x", "accel_y"):
      if name in readings.channels:
        columns = readings.channel == readings.channels.index(name)
        count = np.maximum(readings.used[:, columns].sum(axis=1), 1)
        total += (np.where(readings.used[:, columns], readings.measured[:, columns], 0.0).sum(axis=1) / count) ** 2
    return self.twin.vehicle.mass * np.sqrt(total)

  def simulate(self, theta: Array, starts: Array, moved: Array | None = None) -> tuple[Array, Array]:
    """Predicted readings (n, J, m) and motions at the windows' ends (n, J, 7) of vectors (n, P)."""
    readings = self.readings
    begun, size = readings.begun(starts), len(readings.segments)
    if moved is None:  # those that differ in sensors only share a simulation
      stepped, same = np.unique(self.twin.without_sensors(theta), axis=0, return_inverse=True)
      signals = self.twin.simulate_windows(stepped, readings.segments, begun, EVERY)[same.reshape(-1)]
    else:
      signals = self.twin.simulate_windows(theta, readings.segments, begun, EVERY, moved)
    flat, offset = signals.reshape(-1, *signals.shape[2:]), np.tile(readings.segments.offset, len(theta))
    ended = readings.ends(signals)
    shown = self.twin.sensed(np.repeat(theta, size, axis=0), flat, offset).reshape(signals.shape)
    return readings.predict(shown), ended

  def _slopes(self, moves: Array) -> None:
    twin = self.twin
    pushed = np.repeat(self.theta[None], 4, axis=0)
    for k, name in enumerate(FORCES):
      pushed[k + 1, twin.parameters.index(name)] += _PUSHES[k]
    moved = np.concatenate([np.zeros((1, 7)), np.diag(moves)])
    y, e = self.simulate(np.repeat(self.theta[None], 8, axis=0), self.starts, moved)
    yf, ef = self.simulate(pushed, self.starts, np.zeros((4, 7)))
    self.predicted, self.ended = y[0], e[0]
    slopes = np.concatenate([(y[1:] - y[0]) / moves[:, None, None], (yf[1:] - yf[0]) / _PUSHES[:, None, None]])
    ends = np.concatenate([(e[1:] - e[0]) / moves[:, None, None], (ef[1:] - ef[0]) / _PUSHES[:, None, None]])
    errors = [(self.readings.channel == self._channel(n)).astype(float) for n in (*POSE, *self.biased)]
    own = np.broadcast_to(np.array(errors)[:, None], (len(errors), *self.readings.measured.shape))
    self._raw = np.moveaxis(np.concatenate([slopes, own]), 0, -1)  # (J, m, n)
    self.transition = np.nan_to_num(np.moveaxis(ends, 0, -1))  # (J, 7, 10)
    self.states = self._raw.shape[2]

  def _weigh(self, noise: Noise) -> None:
    """Weights, and the compression that goes with them."""
    self.weight = np.where(self.readings.used, 1.0 / noise.white(self.readings, self._speed), 0.0)
    c = np.clip(np.nan_to_num(self._raw * self.weight[..., None]), -1e7, 1e7)
    if c.shape[1] < self.states:
      c = np.concatenate([c, np.zeros((len(c), self.states - c.shape[1], self.states))], axis=1)
    q, r = np.linalg.qr(c, mode="complete")
    self.basis = np.ascontiguousarray(np.swapaxes(q, 1, 2))[:, :, : self.weight.shape[1]]
    self.slopes = r[:, : self.states]
    self.residual, self.gap = self.misfit(self.predicted, self.ended, self.starts)

  def reweighted(self, noise: Noise, columns: Array, ends: Array) -> tuple[Array, Array]:
    """Columns of this place as they are under other white noise."""
    there = self.under(noise)
    factor = np.where(self.weight > 0.0, there.weight / np.where(self.weight > 0.0, self.weight, 1.0), 0.0)
    raw = np.matmul(np.swapaxes(self.basis, 1, 2), columns)
    return there.compress(raw * factor[..., None]), ends

  def towards(self, theta: Array, starts: Array) -> "Place":
    """The slopes of this place with the prediction of another one close by."""
    made = copy.copy(self)
    predicted, ended = self.simulate(theta[None], starts)
    made.theta, made.starts, made.predicted, made.ended = theta, starts, predicted[0], ended[0]
    made.residual, made.gap = made.misfit(made.predicted, made.ended, starts)
    return made

  def left_over(self, shift: Array, others: Array) -> Array:
    """Residual (J, m) without what smoothed states explain, in standard deviations."""
    states = np.concatenate([shift, others], axis=1)
    return self.residual - np.einsum("jmn,jn->jm", self._raw, states) * self.weight

  def _channel(self, name: str) -> int:
    return self.readings.channels.index(name) if name in self.readings.channels else -1

  def misfit(self, predicted: Array, ended: Array, starts: Array) -> tuple[Array, Array]:
    """Weighted measured minus predicted (J, m), and by how much ends miss the next starts, (J, 7)."""
    residual = np.where(self.readings.used, (self.readings.measured - predicted) * self.weight, 0.0)
    gap = ended - np.roll(starts, -1, axis=0)
    gap[np.append(self.readings.begins[1:], True)] = 0.0
    return residual, gap

  def chain(self, noise: Noise) -> tuple[Chain, Array]:
    """The filter's model under some noise, and the scales of its states beyond the motions, (J, n - 7)."""
    wheelbase, biased = self.twin.car.wheelbase, len(self.biased)
    scale = noise.scales(self._speed, self._load, wheelbase, biased)
    slopes, transition = self.slopes.copy(), self.transition.copy()
    slopes[:, :, 7:] *= scale[:, None]
    transition[:, :, 7:] *= scale[:, None, :3]
    period = self.readings.segments.period
    memory = noise.memory(period, biased)
    return Chain(slopes, transition, self.readings.begins, memory, self.leak, self.prior), scale

  def compress(self, readings: Array) -> Array:
    """Rotate (J, m, p) so that the first n rows see the states and the others don't."""
    return np.matmul(self.basis, readings)

  def first(self, starts: Array) -> Array:
    """Measured minus assumed motion where chains begin, (J, 7)."""
    return np.where(self.readings.begins[:, None], self.readings.starts - starts, 0.0)

  def whiten(
    self, noise: Noise, residual: Array, gap: Array, starts: Array, columns: Array | None = None,
    ends: Array | None = None, keep: bool = False,
  ) -> tuple[Whitened, Filtered | None]:  # fmt: skip
    """Whiten a residual (J, m) with its gaps (J, 7) and compressed columns (J, rows, p) with their ends (J, 7, p)."""
    z, gaps = self.compress(residual[..., None]), gap[..., None]
    if columns is not None and ends is not None:
      z, gaps = np.concatenate([z, columns], axis=2), np.concatenate([gaps, -ends], axis=2)
    innovation, half, states = whiten(self.chain(noise)[0], z[:, : self.states], gaps, self.first(starts), keep)
    return Whitened(innovation, z[:, self.states :], half), states

  def columns(self, theta: Array, moves: Array) -> tuple[Array, Array]:
    """Slopes over vectors that differ from this place by a move each: compressed (J, rows, p), of ends (J, 7, p)."""
    made, ends = [], []
    for low in range(0, len(theta), 24):
      some = slice(low, low + 24)
      y, e = self.simulate(theta[some], self.starts)
      step = moves[some, None, None]
      change = np.clip((y - self.predicted) * self.weight, -_WILDEST, _WILDEST) / step
      made.append(self.compress(np.nan_to_num(np.moveaxis(change, 0, -1))))
      ends.append(np.nan_to_num(np.moveaxis((e - self.ended) / step, 0, -1)))
    out = np.concatenate(ends, axis=2)
    out[np.append(self.readings.begins[1:], True)] = 0.0
    return np.concatenate(made, axis=2), out

  def force_columns(self) -> tuple[Array, Array]:
    """Slopes over a force in every window: compressed (J, rows, 3), and of ends (J, 7, 3)."""
    ends = self.transition[:, :, 7:10].copy()
    ends[np.append(self.readings.begins[1:], True)] = 0.0
    return self.compress(np.nan_to_num(self._raw[:, :, 7:10] * self.weight[..., None])), ends

  def smoothed(self, noise: Noise, residual: Array, gap: Array, starts: Array) -> tuple[Array, Array]:
    """Means of the starts' deviations (J, 7) and of forces, pose errors, biases (J, n - 7), in their units."""
    _, states = self.whiten(noise, residual, gap, starts, keep=True)
    assert states is not None
    chain, scale = self.chain(noise)
    mean = smooth(chain, states)
    return mean[:, :7], mean[:, 7:] * scale
