"""Names that can't be told apart: what they share, which goes first, and when there are too many to claim one."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.score import compare, compare_freely
from calibration.diagnosis.search.claims import claim
from calibration.diagnosis.search.decide import decide
from calibration.diagnosis.search.thresholds import Thresholds
from qcar_twin.parameters import Parameter, ParameterSet
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.diagnosis_results import concluded


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
  alone = decide(twins_of(offset_pool, "steering_offset", [])).claims[0].probability
  tied = decide(twins_of(offset_pool, "steering_offset", ["side_force"]))
  assert tied.claims[0].probability == pytest.approx(0.5 * alone, abs=0.05) and alone > 0.9
  assert {tied.claims[0].mechanism, *tied.claims[0].equivalent_to} == {"steering_offset", "side_force"}
  assert tied.verdict == "explained"


def test_a_rival_that_leaves_bent_what_the_claim_frees_can_be_told_apart(offset_pool):
  pool = twins_of(offset_pool, "steering_offset", ["side_force"])
  claimed, rival = (pool.models[frozenset([n])] for n in ("steering_offset", "side_force"))
  bent = dataclasses.replace(rival, values=rival.values.copy())
  bent.values[bent.free.index("mass")] += 12.0 * rig.BASE["mass"].std  # 72 nats
  pool.models[frozenset(["side_force"])] = bent
  assert compare(claimed, bent, pool.problem.observations).t == 0.0
  assert claim(pool, claimed, "steering_offset", Thresholds()).equivalent_to == ()
  assert claim(pool, claimed, "steering_offset", Thresholds(priors=80.0)).equivalent_to == ("side_force",)


def test_what_acts_beyond_doubt_under_names_too_many_to_claim_is_unexplained(offset_pool):
  pool = twins_of(offset_pool, "steering_offset", ["side_force"])
  needed = Thresholds(probability=0.7)
  decision = decide(pool, needed)
  assert decision.verdict == "unexplained" and decision.claims == ()
  assert "steering_offset" in decision.alarm and "side_force" in decision.alarm
  assert concluded(pool, decision).verdict == "unexplained"
  assert decide(pool, dataclasses.replace(needed, sure=np.inf)).verdict == "no_mismatch"


def with_parameters_that_foretell_nothing(model, count):
  """A model with more free parameters, each along a direction drawn by chance."""
  rows = slice(0, model.n_train)
  columns = np.random.default_rng(5).standard_normal((len(model.residual), count))
  sizes = np.linalg.lstsq(columns[rows], -model.residual[rows], rcond=None)[0]
  residual = model.residual.copy()
  residual[rows] += columns[rows] @ sizes
  spare = [Parameter(f"spare_{k}", 0.0, -1e3, 1e3, "-", "s", typical=1e2) for k in range(count)]
  return dataclasses.replace(
    model,
    residual=residual,
    free=model.free + spare,
    values=np.concatenate([model.values, sizes]),
    jacobian=np.concatenate([model.jacobian, columns], axis=1),
  )


def test_a_name_goes_first_that_held_out_evidence_prefers_to_the_one_that_fits_best(offset_pool):
  """The other fits better what it was fitted to, by parameters that foretell nothing."""
  pool = twins_of(offset_pool, "steering_offset", ["side_force"])
  right, wrong, observations = frozenset(["steering_offset"]), frozenset(["side_force"]), pool.problem.observations
  pool.models[wrong] = with_parameters_that_foretell_nothing(pool.models[wrong], 80)
  assert pool.models[wrong].cost < pool.models[right].cost - 20.0
  assert compare_freely(pool.models[wrong], pool.models[right], observations).gain < 0.0
  assert decide(pool).claims[0].mechanism == "steering_offset"


def test_what_is_only_found_beside_a_name_too_doubtful_to_claim_is_not_claimed_either(pair_pool):
  """Beside a force the trim ties with another name; alone it has no rival, and the force alone brings nothing."""
  force, trim = frozenset(["side_force"]), frozenset(["steering_offset"])
  pair = pair_pool.models[force | trim]
  nothing = dataclasses.replace(pair_pool.models[force], residual=pair_pool.base.residual)
  models = {frozenset(): pair_pool.base, trim: pair_pool.models[trim], force: nothing, force | trim: pair}
  models[frozenset(["side_force", "gyro_scale"])] = renamed(pair_pool, pair, "steering_offset", "gyro_scale")
  pool, needed = dataclasses.replace(pair_pool, models=models), Thresholds(probability=0.6)
  weighed = {c: claim(pool, pair, c, needed).probability for c in pair.mechanisms}
  assert weighed["steering_offset"] < 0.6 < weighed["side_force"]
  assert [c.mechanism for c in decide(pool, needed).claims] == ["steering_offset"]
  # the force by itself once it explains something: the better of the two
  better = dataclasses.replace(pool, models=models | {force: pair_pool.models[force]})
  cheaper = min((pair_pool.models[force], pair_pool.models[trim]), key=lambda m: m.cost)
  assert [c.mechanism for c in decide(better, needed).claims] == list(cheaper.mechanisms)


def test_what_a_name_is_still_needed_beside_is_no_rival(pair_pool):
  """Both act: the one that brings less is doubted only as long as nobody looked at them together."""
  force, trim = frozenset(["side_force"]), frozenset(["steering_offset"])
  (weaker,) = max((force, trim), key=lambda key: pair_pool.models[key].cost)
  weigh = lambda pool: claim(pool, pool.models[frozenset([weaker])], weaker, Thresholds()).probability
  apart = dataclasses.replace(pair_pool, models={k: m for k, m in pair_pool.models.items() if k != force | trim})
  assert weigh(pair_pool) > 0.8 > 0.6 > weigh(apart)
  stronger = next(iter((force | trim) - {weaker}))
  same = dataclasses.replace(pair_pool.models[force | trim], residual=pair_pool.models[frozenset([stronger])].residual)
  needless = dataclasses.replace(pair_pool, models={**pair_pool.models, force | trim: same})
  assert weigh(needless) == weigh(apart)
