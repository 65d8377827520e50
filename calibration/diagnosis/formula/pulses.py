"""How what is measured answers a short push on one degree of freedom: the columns from which a force is recovered.

Every stretch of driving is a simulation of its own, so one parameter vector per pulse number gives the columns of all
stretches at once. The reduced car is simulated, also where MuJoCo puts it right: a correction drops out of differences.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.likelihood import Problem
from calibration.fitting.observations import Observations
from qcar_twin.parameters import Parameter
from qcar_twin.plant import signal_index
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.mechanism import commanded, pushed
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.twin import Twin

WIDTH = 0.05  # s of a pulse
# shares of a degree's scale that a pulse has: a push of 0.03 g, a turn of the wheels by a fiftieth of the lock
_SIZES = {"force_x": 0.03, "force_y": 0.03, "moment_z": 0.01, "motor_torque": 0.03, "steering_angle": 0.05}
DRIVEN = tuple(_SIZES)  # degrees that have to be simulated


class Pulse(Mechanism):
  """A push of `size`, in the unit of its degree, over one pulse's width."""

  stage = "actuator"
  subsystem = "body"
  signed = True

  def __init__(self, degree: str):
    self.degree = degree
    parameters = (
      Parameter(f"pulse_{degree}", 0.0, -1e6, 1e6, DEGREES[degree].unit, null=0.0, typical=1.0),
      Parameter(f"pulse_{degree}_number", 0.0, 0.0, 1e6, "-", typical=1.0),
    )
    vars(self).update(name=f"pulse_{degree}", parameters=parameters)

  def _value(self, theta: Array, context: Context) -> Array:
    # half a period on: no rounding of sums decides which pulse a period belongs to
    return theta[:, 0] * (np.floor((context.time + 0.5 * context.period) / WIDTH) == theta[:, 1])

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    return commanded(self.degree, context, command, lambda: self._value(theta, context))

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    return pushed(self.degree, len(theta), lambda: self._value(theta, context))


@dataclasses.dataclass(frozen=True)
class Responses:
  """Columns of one degree of freedom.

  Attributes:
    degree: one of DEGREES.
    rows: values of each stretch, S index arrays.
    columns: by how much they change per unit of the degree's scale over one pulse, whitened, S arrays (M_s, K).
    scale: the degree's natural size, in its unit.
  """

  degree: str
  rows: list[NDArray[np.intp]]
  columns: list[Array]
  scale: float

  @property
  def pulses(self) -> int:
    """Pulses per stretch, K."""
    return self.columns[0].shape[1]


def stretches(observations: Observations) -> list[NDArray[np.intp]]:
  """Indices of the values of each stretch."""
  stretch = observations.stretch
  return [np.flatnonzero(stretch == s) for s in range(len(observations.stretches.segments))]


def pulse_count(observations: Observations) -> int:
  """Pulses in the longest stretch."""
  segments = observations.stretches.segments
  return int(np.ceil(segments.commands.shape[1] * segments.period / WIDTH - 1e-9))


def responses(problem: Problem, theta: Array, degree: str) -> Responses:
  """Columns of one degree of freedom about a model, full parameters (P,)."""
  observations = problem.observations
  rows, count, scale = stretches(observations), pulse_count(observations), DEGREES[degree].scale(problem.twin.car)
  if degree not in DRIVEN:
    return Responses(degree, rows, _read(problem, degree, rows, count, scale), scale)
  twin, size = searched(problem.twin), _SIZES[degree] * scale
  pushed = twin.with_mechanisms([*twin.mechanisms, Pulse(degree)])
  probe = Problem(pushed, observations, problem.weighting, problem.n_train, problem.base)
  names = [p.name for p in problem.parameters]
  base = probe.embed(names, theta[: len(names)], pushed.parameters.nominal)
  thetas = np.repeat(base, count + 1, axis=0)
  thetas[1:, pushed.parameters.index(f"pulse_{degree}")] = size
  thetas[1:, pushed.parameters.index(f"pulse_{degree}_number")] = np.arange(count)
  residual = probe.residual(thetas)
  change = (residual[1:] - residual[0]) * (scale / size)
  return Responses(degree, rows, [np.ascontiguousarray(change[:, r].T) for r in rows], scale)


def searched(twin: Twin) -> Twin:
  """What is simulated for columns: the reduced car where there is one, without corrections."""
  return twin.with_mechanisms(twin.mechanisms)


def _read(problem: Problem, degree: str, rows: list[NDArray[np.intp]], count: int, scale: float) -> list[Array]:
  """Columns of a sensor: its reading is off by what the pulse says."""
  observations, signal = problem.observations, DEGREES[degree].signal
  segments, out = observations.stretches.segments, []
  whitening = problem.whiten(np.ones(len(observations))) * np.where(observations.select(signal), scale, 0.0)
  for s, own in enumerate(rows):
    columns = np.zeros((len(own), count))
    at = (observations.time[own] - segments.offset[s]) / WIDTH
    columns[np.arange(len(own)), np.clip(at.astype(int), 0, count - 1)] = whitening[own]
    out.append(columns)
  return out


def readable(observations: Observations) -> tuple[str, ...]:
  """Degrees that are sensors of this log."""
  return tuple(
    n for n, d in DEGREES.items() if d.signal and d.signal in observations.present and signal_index(d.signal)
  )
