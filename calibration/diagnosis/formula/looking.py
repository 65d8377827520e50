"""A look at what a model leaves over: on which places a force is missing, and what it is a function of there."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, candidate, simulate
from calibration.diagnosis.formula.columns import Driven, Fitted
from calibration.diagnosis.formula.forms import Forms, forms_of
from calibration.diagnosis.formula.minimum import thinned
from calibration.diagnosis.formula.moments import fading, moments, variables
from calibration.diagnosis.formula.pulses import DRIVEN, WIDTH, Responses, readable, responses, searched
from calibration.diagnosis.formula.recovery import Base, Recovered, recover
from calibration.fitting.likelihood import Problem
from calibration.fitting.slopes import finite_differences
from calibration.intervals.clusters import groups_of
from calibration.progress import Progress, silent
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.plant import Prediction
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.mechanism import commanded, pushed
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State

STAGE = "formula for the rest"
_ASKED = 3  # degrees of freedom, those of the largest evidence, whose forms are sought
ALIKE = 10.0  # nats of evidence, or of a fit's cost, within which two degrees of freedom can't be told apart


@dataclasses.dataclass(frozen=True)
class Sought:
  """One degree of freedom that was looked into.

  Attributes:
    recovered: its force over time.
    responses: its columns.
    driven: the driving with that force.
    forms: None where nothing is worth its coefficients.
  """

  recovered: Recovered
  responses: Responses
  driven: Driven
  forms: Forms | None


@dataclasses.dataclass(frozen=True)
class Looked:
  """What is seen from one base.

  Attributes:
    base: the model that it is seen from.
    fitted: what is fitted there.
    there: degrees of freedom on which something is neither chance nor immaterial, the one of the largest gain first.
    stands_for: other degrees that explain as much as one that was looked into, and were not.
  """

  base: Candidate
  fitted: Fitted
  there: tuple[Sought, ...]
  stands_for: dict[str, list[str]]


def stood(problem: Problem, base: Candidate, priors: ParameterSet) -> tuple[Problem, Candidate]:
  """A model where its parameters are, with its residual and slopes in this problem's weights, put right there.

  Args:
    problem: with the weights.
    base: where the parameters are.
    priors: declarations of the base parameters.
  """
  near = problem.at(problem.embed(base.free.names, base.values, problem.parameters.nominal)[0])
  model = candidate(near, base.mechanisms, base, priors)
  simulate(near, [model])
  n, residual = model.n_train, lambda v: near.fitted_residual(near.embed(model.free.names, v, model.theta))
  model.jacobian[:n] = finite_differences(residual, model.free, model.values, model.residual[:n])
  return near, model


def look(
  problem: Problem,
  base: Candidate,
  random: np.random.Generator,
  progress: Progress = silent,
  share: tuple[float, float] = (0.0, 1.0),
) -> Looked:
  """What a model leaves over, on all degrees of freedom.

  Args:
    problem: put right at the model.
    base: the model, with its slopes there.
    random: draws halves and signs.
    progress: reports the share that is done.
    share: of the stage before and after it.
  """
  part, model = thinned(problem, base)
  fitted = _fitted(part, model)
  degrees, pairs, (begin, end) = (*DRIVEN, *readable(part.observations)), [], share
  for k, name in enumerate(degrees):
    progress(STAGE, begin + 0.5 * (end - begin) * k / len(degrees))
    pairs.append(recovered(part, model, fitted.base, name))
  pairs.sort(key=lambda pair: -pair[0].evidence)
  asked, stands_for = _worth_asking(pairs)
  sought = []
  for k, pair in enumerate(asked):
    progress(STAGE, begin + (end - begin) * (0.5 + 0.5 * k / len(asked)))
    sought.append(look_into(part, model, fitted, *pair, random))
  there = sorted((s for s in sought if s.forms and s.forms.there), key=lambda s: -gain(s))
  return Looked(base, fitted, tuple(there), stands_for)


def gain(sought: Sought) -> float:
  """Held out, of its formula or table, nats."""
  return sought.forms.gain if sought.forms else 0.0


def _fitted(part: Problem, model: Candidate) -> Fitted:
  observations, base = part.observations, Base.of(model)
  second = observations.recording * 1_000_000 + observations.time.astype(np.int64)
  return Fitted(base, base.rest, groups_of(observations), second)


def recovered(problem: Problem, winner: Candidate, base: Base, degree: str) -> tuple[Recovered, Responses]:
  """A degree of freedom's force over time, and the columns it came from."""
  answers = responses(problem, winner.theta, degree)
  return recover(base, answers), answers


def look_into(
  problem: Problem,
  winner: Candidate,
  fitted: Fitted,
  force: Recovered,
  answers: Responses,
  random: np.random.Generator,
) -> Sought:
  """What a degree of freedom's force is a function of."""
  observations, twin = problem.observations, problem.twin
  prediction = replayed(problem, winner.theta, force)
  context = moments(twin, winner.theta, observations, prediction)
  stretches = observations.stretches
  driven = Driven(variables(context, observations), fading(context, stretches), twin.car, stretches.segments.period)
  return Sought(force, answers, driven, forms_of(answers, driven, fitted, random))


Pair = tuple[Recovered, Responses]


def _worth_asking(pairs: Sequence[Pair]) -> tuple[list[Pair], dict[str, list[str]]]:
  """Degrees of freedom of the largest evidence; and which others are as good as one of them.

  A torque of the motor pushes the car as a force along it does, but for what the tyres slip: where the evidence does
  not tell them apart, the force stands for both.
  """
  there = [pair for pair in pairs if pair[0].evidence > 0.0]
  evidence = {pair[0].degree: pair[0].evidence for pair in there}
  both = {"force_x", "motor_torque"} <= set(evidence)
  if both and abs(evidence["force_x"] - evidence["motor_torque"]) < ALIKE:
    there = [pair for pair in there if pair[0].degree != "motor_torque"]
    return there[:_ASKED], {"force_x": ["motor_torque"]}
  return there[:_ASKED], {}


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
    return commanded(self.degree, context, command, lambda: self._value(context))

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    return pushed(self.degree, len(theta), lambda: self._value(context))


def replayed(problem: Problem, theta: Array, recovered: Recovered) -> Prediction:
  """Signals of the model, full parameters (P,), with the force; of a sensor's error those of the model itself.

  A formula's variables are read off these: without the force the car is where the missing one would not have let it go.

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
