"""A formula in the simulator: with the base at their common minimum, whatever the base had taken over before."""

import numpy as np
import pytest

from calibration.diagnosis.candidates import Candidate, candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula import after
from calibration.diagnosis.formula.after import TWIN, Shipped, weighed, write_formula
from calibration.diagnosis.formula.columns import Driven
from calibration.diagnosis.formula.finding import find_formula
from calibration.diagnosis.formula.minimum import at_minimum, thinned
from calibration.diagnosis.formula.moments import fading, moments, variables
from calibration.diagnosis.formula.refit import Refitted, fitted_best, refitted
from calibration.diagnosis.formula.report import formula_sections
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import clustered_std
from calibration.fitting.likelihood import Problem, Weighting
from calibration.fitting.observations import CHANNELS, observe
from calibration.fitting.slopes import NotFinite
from calibration.fitting.surrogate import Surrogate
from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import SIGNALS
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.formula.law import BEYOND
from qcar_twin.twin.formula.mechanism import limited
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.twin.formula.formulas import twin_with, yaw_drag

NOISE = {"motor_speed": 1.0, "yaw_rate": 0.02, "accel_x": 0.1, "accel_y": 0.1}
FREE = ("torque_per_volt", "motor_damping", "friction_coefficient", "cornering_stiffness_front", "yaw_inertia")


def measured(drag: float) -> list[Recording]:
  """Six turns of six seconds; the last two only judge."""
  time, random = np.arange(0.0, 6.0 - 1e-9, 0.01), np.random.default_rng(0)
  commands = [(1.2 + 0.25 * k + 0.6 * np.sin(time + k), 0.06 * k + 0.12 * np.sin(1.7 * time)) for k in range(6)]
  blank = lambda k: {n: Stream(time, commands[k][i]) for i, n in enumerate(("motor_voltage", "steering_command"))} | {
    n: Stream(time, 0.0 * time) for n in NOISE}  # fmt: skip
  empty = [Recording(f"run_{k}", blank(k), role="validate" if k > 3 else "identify") for k in range(6)]
  twin, theta = twin_with(limited(yaw_drag(), 99.0), unnamed_force_x_1=drag)
  signals = twin.rollout(theta[None], cut_recordings(empty, twin.vehicle).segments).signals[0]
  shown = lambda k, n: signals[k, : len(time), SIGNALS.index(n)] + NOISE[n] * random.standard_normal(len(time))
  return [r.replace(streams=dict(r.streams) | {n: Stream(time, shown(k, n)) for n in NOISE})
          for k, r in enumerate(empty)]  # fmt: skip


def turned() -> tuple[Problem, Candidate, ParameterSet]:
  """The turns with a drag of -1.2 N s/rad, the base at its minimum without one, and what is declared of the base."""
  twin = Twin(Vehicle(), [], threads=1, engine="reduced")
  recordings = measured(-1.2)
  observations = observe(recordings, twin.vehicle)
  std = np.array([NOISE.get(name, 0.02) for name in CHANNELS])
  weighting = Weighting(std, np.ones(len(CHANNELS)), np.ones(len(observations)))
  priors = ParameterSet(twin.base[name] for name in FREE)
  problem = Problem(twin, observations, weighting, int(np.sum(observations.recording < 4)), FREE)
  _, winner = at_minimum(problem, candidate(problem, (), None, priors))
  return problem, winner, priors


@pytest.fixture(scope="module")
def case():
  return turned()


def with_drag(problem, bases, priors) -> Refitted:
  """A drag by the yaw rate, refitted from half its size."""
  winner, stretches = bases[0], problem.observations.stretches
  context = moments(problem.twin, winner.theta, problem.observations, problem.predict(winner.theta[None]))
  driven = Driven(variables(context, problem.observations), fading(context, stretches), problem.twin.car, 0.01)
  trial = fitted_best(problem, bases, priors, [(limited(yaw_drag(), 99.0), {"unnamed_force_x_1": -0.5}, 0.0)])
  return refitted(problem, winner, priors, trial, driven)


def test_the_base_takes_over_what_it_can(case):
  problem, winner, priors = case
  nominal = problem.residual(problem.parameters.nominal[None])[0]
  assert winner.cost < 0.9 * 0.5 * float(nominal[: problem.n_train] @ nominal[: problem.n_train])
  assert np.abs((winner.values - priors.nominal) / priors.scale).max() > 0.3


def test_from_there_base_and_formula_come_to_the_truth_together(case):
  problem, winner, priors = case
  found = with_drag(problem, [winner], priors)
  ((_, value, std),) = found.values
  assert value == pytest.approx(-1.2, abs=4.0 * std) and std < 0.06
  scatter = clustered_std(found.model, problem.observations)[found.model.free.index("unnamed_force_x_1")]
  assert std == scatter >= found.model.estimate("unnamed_force_x_1")[1]
  assert np.abs((found.model.values[: len(FREE)] - priors.nominal) / found.model.std[: len(FREE)]).max() < 4.0
  assert found.judged is not None and found.held_out.t > 10.0 and found.judged.t > 10.0
  turning = np.abs(problem.predict(winner.theta[None]).signals[..., SIGNALS.index("yaw_rate")]).max()
  assert found.mechanism.law.limit == pytest.approx(BEYOND * turning * abs(value), rel=0.1)


def test_no_formula_is_paid_for_a_valley_that_the_model_alone_missed(case):
  problem, winner, priors = case
  aside = candidate(problem, (), winner, priors, {"torque_per_volt": 0.7 * winner.estimate("torque_per_volt")[0]})
  aside.residual = problem.residual(aside.theta[None])[0]
  assert aside.cost > 2.0 * winner.cost
  before = with_drag(problem, [aside, winner], priors).before
  assert before.cost < winner.cost + 2.0


def test_noise_is_what_the_model_leaves(case):
  problem, winner, _ = case
  again, model = weighed(problem, winner, NOISE)
  left = problem.raw(winner.theta[None])[0]
  rows = problem.observations.channel == CHANNELS.index("motor_speed")
  assert again.weighting.std[CHANNELS.index("motor_speed")] == pytest.approx(np.std(left[rows]), rel=0.3)
  assert model.cost < 0.01 * winner.cost


def test_of_a_long_log_a_share_is_kept_of_what_is_fitted_and_of_what_judges(case):
  """Four stretches of 6 s are fitted and two judge: half of each."""
  problem, winner, _ = case
  part, model = thinned(problem, winner, most=12.0, judges=True)
  assert part.observations.stretches.segments.recording == ("run_1", "run_3", "run_5")
  assert (
    part.n_train == model.n_train == int(np.sum(np.isin(problem.observations.recording[: problem.n_train], (1, 3))))
  )
  np.testing.assert_allclose(part.residual(winner.theta[None])[0], model.residual, atol=1e-9)
  alone, _ = thinned(problem, winner, most=12.0)
  assert alone.observations.stretches.segments.recording == ("run_1", "run_3")
  whole, same = thinned(problem, winner, judges=True)
  assert len(whole.observations) == len(problem.observations) and same.n_train == winner.n_train


def test_no_force_is_sought_where_the_reduced_car_leads_astray(case):
  exact, winner, _ = case
  segments = exact.observations.stretches.segments
  stretches = list(zip(segments.recording, segments.offset.tolist(), strict=True))
  searched = Problem(Surrogate(exact.twin), exact.observations, exact.weighting, exact.n_train, exact.base)
  part, model = thinned(searched.guarding(stretches[:1]), winner)
  assert part.observations.stretches.segments.recording == ("run_1", "run_2", "run_3")
  assert part.n_train == model.n_train == len(model.residual)
  assert thinned(searched.guarding(stretches), winner)[0].n_train == exact.n_train  # better than nowhere


def test_a_car_that_flies_apart_leaves_the_verdict_alone_and_the_page_says_so(case, tmp_path, monkeypatch):
  problem, winner, priors = case
  pool = Pool(problem, priors, {frozenset(): winner}, {}, NOISE)

  def flies(*_args):
    raise NotFinite("the simulation is not finite when mass moves")

  monkeypatch.setattr(after, "at_minimum", flies)
  decision = Decision("unexplained", (), (), (), None, ())
  shipped = after.formula_left(pool, decision, [], Cut())
  assert not shipped.kept and write_formula(shipped, tmp_path, "a session") == []
  (section,) = formula_sections(shipped)
  assert "broke off (the simulation is not finite when mass moves)" in section.text


@pytest.mark.slow
def test_a_concealed_drag_is_found_from_the_start_to_its_file(case, tmp_path):
  problem, winner, priors = case
  problem, winner = at_minimum(*weighed(problem, winner, NOISE))
  found = find_formula(problem, winner, winner, priors)
  assert found.kind == "formula" and found.twin is not None
  assert found.twin.mechanism.law.terms == ("abs(yaw_rate) * sign(speed)",)
  value, std = found.twin.model.estimate("unnamed_force_x_1")
  assert value == pytest.approx(-1.2, abs=3.0 * std) and std < 0.2
  files = write_formula(Shipped(found, {}), tmp_path, "a session")
  assert [f.name for f in files] == ["unnamed_force_x.py", TWIN]
