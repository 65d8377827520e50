"""Names that can't be told apart: what they share, which goes first, and when there are too many to claim one."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.decision.decide import decide
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.weighing import probability
from calibration.diagnosis.search.gather import gather
from qcar_twin.parameters import ParameterSet
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.diagnosis_results import EASY, claimed_of, concluded, decided


def twins_of(pool, name, others):
  """The pool with models of other names that leave exactly what one leaves."""
  single = pool.models[frozenset([name])]
  models = {frozenset(): pool.base, frozenset([name]): single}
  return dataclasses.replace(pool, models=models | {frozenset([o]): renamed(pool, single, name, o) for o in others})


def renamed(pool, single, name, other):
  """A model of another mechanism with the residuals of the first, its first amplitude at its typical size."""
  declared = pool.problem.mechanism(other).parameters
  amplitude = next(p for p in declared if p.null is not None)
  mine = next(p for p in pool.problem.mechanism(name).parameters if p.null is not None)
  index = single.free.index(mine.name)
  free = ParameterSet(amplitude if p.name == mine.name else p for p in single.free)
  values = single.values.copy()
  values[index] = amplitude.null + (amplitude.typical or amplitude.scale)
  return dataclasses.replace(
    single, mechanisms=tuple(sorted({*single.mechanisms, other} - {name})), free=free, values=values
  )


def test_names_that_fit_equally_well_share_the_probability(offset_pool):
  levels = dataclasses.replace(EASY, claim=0.45)
  alone = decided(twins_of(offset_pool, "steering_offset", []), levels).claims[0].probability
  tied = decided(twins_of(offset_pool, "steering_offset", ["side_force"]), levels)
  assert tied.claims[0].probability == pytest.approx(0.5 * alone, abs=0.02) and alone > 0.9
  assert {tied.claims[0].mechanism, *tied.claims[0].indistinguishable_from} == {"steering_offset", "side_force"}
  assert tied.verdict == "explained"


def test_a_rival_that_leaves_bent_what_the_claim_frees_can_be_told_apart(offset_pool):
  pool = twins_of(offset_pool, "steering_offset", ["side_force"])
  claimed, rival = (pool.models[frozenset([n])] for n in ("steering_offset", "side_force"))
  mass, levels = rig.BASE["mass"], usual_levels()
  for share, equivalent in ((0.9, ("side_force",)), (1.1, ())):
    bent = dataclasses.replace(rival, values=rival.values.copy())
    bent.values[bent.free.index("mass")] = mass.nominal + mass.std * np.sqrt(2.0 * share * levels.near)
    straight = dataclasses.replace(claimed, values=claimed.values.copy())
    straight.values[straight.free.index("mass")] = mass.nominal
    models = pool.models | {frozenset(["side_force"]): bent, frozenset(["steering_offset"]): straight}
    found = claimed_of(dataclasses.replace(pool, models=models), straight, "steering_offset", levels)
    assert found.indistinguishable_from == equivalent


def test_what_acts_under_names_too_many_to_claim_is_unexplained(offset_pool):
  pool = twins_of(offset_pool, "steering_offset", ["side_force"])
  needed = dataclasses.replace(usual_levels(), claim=0.7)
  decision = decided(pool, needed)
  assert decision.claims == ()
  assert "steering_offset" in decision.undecided and "side_force" in decision.undecided
  assert concluded(pool, decision).verdict == "unexplained"
  assert decided(pool, dataclasses.replace(needed, claim=0.999)).undecided == ""


def test_the_likeliest_name_is_told_where_none_is_claimed(offset_pool):
  pool = twins_of(offset_pool, "steering_offset", [])
  probable = decided(pool, usual_levels()).claims[0].probability
  short = decided(pool, dataclasses.replace(usual_levels(), claim=0.999))
  assert not short.claims and short.nearest.startswith("The likeliest name is steering_offset")
  assert f"{probable:.2f} where 0.999 is needed" in short.nearest
  assert decided(pool, usual_levels()).nearest == ""
  many = decided(
    twins_of(offset_pool, "steering_offset", ["side_force"]), dataclasses.replace(usual_levels(), claim=0.7)
  )
  assert many.undecided and many.nearest == ""


def test_a_name_goes_first_that_is_likelier_and_not_the_one_that_fits_best(offset_pool):
  """The other fits a nat better what was fitted, and predicts less surely what was left out."""
  evidence = gather(twins_of(offset_pool, "steering_offset", ["side_force"]))
  force, trim = sorted(evidence.of_size(1), key=lambda m: m.mechanisms)
  apart = lambda a, by: dataclasses.replace(a, nats=a.nats + by, behind_t=2.0)
  name, other = trim.names[0], force.names[0]
  name = dataclasses.replace(name, alternatives=tuple(apart(a, 1.0) for a in name.alternatives))
  test = other.held_out
  test = dataclasses.replace(test, drop=test.drop + 1.0, gain=3.0 * test.standard_error - test.priors)
  other = dataclasses.replace(other, held_out=test, alternatives=tuple(apart(a, 0.0) for a in other.alternatives))
  models = tuple(dataclasses.replace(m, names=(n,), drop=n.held_out.drop) for m, n in ((trim, name), (force, other)))
  decision = decide(dataclasses.replace(evidence, models=(evidence.base, *models)), EASY)
  assert probability(name, EASY) > probability(other, EASY) > 0.5 and name.t > 3.0
  assert models[1].drop > models[0].drop and decision.claims[0].mechanism == "steering_offset"


def test_what_is_only_likely_beside_a_name_too_doubtful_to_claim_is_weighed_alone(pair_pool):
  """Beside a force the trim ties with another name; alone it has no rival."""
  force, trim = frozenset(["side_force"]), frozenset(["steering_offset"])
  pair = pair_pool.models[force | trim]
  nothing = dataclasses.replace(pair_pool.models[force], residual=pair_pool.base.residual)
  models = {frozenset(): pair_pool.base, trim: pair_pool.models[trim], force: nothing, force | trim: pair}
  models[frozenset(["side_force", "gyro_scale"])] = renamed(pair_pool, pair, "steering_offset", "gyro_scale")
  pool, needed = dataclasses.replace(pair_pool, models=models), dataclasses.replace(usual_levels(), claim=0.6)
  weighed = {c: claimed_of(pool, pair, c, needed).probability for c in pair.mechanisms}
  assert weighed["steering_offset"] < 0.6 < weighed["side_force"]
  assert [c.mechanism for c in decided(pool, needed).claims] == ["steering_offset"]
