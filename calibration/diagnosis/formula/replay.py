"""The car as it drives with the recovered force: what a formula's variables are read off.

Without it the model's car is where the missing force would not have let it go, and a formula of its states is bent.
"""

import numpy as np

from calibration.diagnosis.formula.pulses import WIDTH, searched
from calibration.diagnosis.formula.recovery import Recovered
from calibration.fitting.likelihood import Problem
from qcar_twin.parameters import Parameter
from qcar_twin.plant import Prediction
from qcar_twin.twin.formula.degrees import BODY, DEGREES
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State


class Replay(Mechanism):
  """A force over time in every stretch, (S, K), in the unit of its degree; one car per stretch, in their order."""

  stage = "actuator"
  subsystem = "body"

  def __init__(self, degree: str, force: Array):
    self.degree, self.force = degree, force
    parameters = (Parameter("replayed", 0.0, 0.0, 1.0, "-", null=0.0, typical=1.0),)
    vars(self).update(name="replay", parameters=parameters)

  def _value(self, context: Context) -> Array:
    pulse = int((context.time + 0.5 * context.period) / WIDTH)
    return self.force[:, min(pulse, self.force.shape[1] - 1)]

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    if self.degree in BODY:
      return command
    out = command.copy()
    if self.degree == "motor_torque":
      out[:, 0] += self._value(context) / context.torque_per_volt
    else:
      out[:, 1] += self._value(context)
    return out

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    out = np.zeros((len(theta), 3))
    if self.degree in BODY:
      out[:, BODY.index(self.degree)] = self._value(context)
    return out


def replayed(problem: Problem, theta: Array, recovered: Recovered) -> Prediction:
  """Signals of the model, full parameters (P,), with the force; of a sensor's error those of the model itself.

  A surrogate's correction is added, as everywhere else.
  """
  if DEGREES[recovered.degree].signal:
    return problem.predict(theta[None])
  scale = DEGREES[recovered.degree].scale(problem.twin.car)
  twin = searched(problem.twin)
  pushed = twin.with_mechanisms([*twin.mechanisms, Replay(recovered.degree, recovered.force * scale)])
  names, segments = [p.name for p in problem.parameters], problem.observations.stretches.segments
  full = pushed.parameters.nominal
  full[[pushed.parameters.index(name) for name in names]] = theta[: len(names)]
  still = pushed.rollout(full[None], segments).signals
  full[pushed.parameters.index("replayed")] = 1.0
  moved = pushed.rollout(full[None], segments).signals
  signals = problem.predict(theta[None]).signals + np.nan_to_num(moved - still)
  return Prediction(signals, segments.period)
