"""Search: a minimum that was found with a mechanism in the model is offered to the models without it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.candidates import candidate, simulate
from calibration.diagnosis.pool import base_candidate
from calibration.diagnosis.scan import scan
from calibration.diagnosis.search.beginnings import begin_sets
from calibration.diagnosis.search.structure import (
  Effort,
  _explains,
  _nominate_pairs,
  _without_trifles,
  refine_leaders,
  refine_stalled,
  search,
)
from calibration.diagnosis.search.warm_start import exchange, level, warm_start
from calibration.fitting.recalibration import recalibrate_from
from tests.calibration.diagnosis import diagnosis_rig as rig


def astray(pool, by):
  """The pool with a base that stopped far from its minimum: voltage and damping `by` too large."""
  base = dataclasses.replace(pool.base, values=pool.base.values.copy(), theta=pool.base.theta.copy())
  for name in ("torque_per_volt", "motor_damping"):
    base.values[base.free.index(name)] *= 1.0 + by
    base.theta[pool.problem.parameters.index(name)] *= 1.0 + by
  simulate(pool.problem, [base])
  return dataclasses.replace(pool, models=pool.models | {frozenset(): base})


def test_a_base_that_stopped_short_is_taken_to_the_minimum_a_larger_model_found(clean_pool):
  """Without the return, a mechanism without any effect would be worth all the nats that the base is short of."""
  pool, best = astray(clean_pool, 0.3), clean_pool.models[frozenset(["side_force"])]
  assert pool.base.cost > clean_pool.base.cost + 100.0
  level(pool, best)
  assert pool.base.cost == pytest.approx(clean_pool.base.cost, rel=1e-3)


def test_sets_go_on_from_where_their_delays_are_exchanged(clean_pool, monkeypatch):
  """Those that the best one holds, the recalibrated twin among them; where priors gain nothing by it all stay."""
  pool, best = astray(clean_pool, 0.3), clean_pool.models[frozenset(["side_force"])]
  stood = {key: model.cost for key, model in pool.models.items()}
  exchange(pool, best)
  assert {key: model.cost for key, model in pool.models.items()} == stood
  there = lambda free, values, worth: clean_pool.base.values if free.names == pool.base.free.names else None
  monkeypatch.setattr("calibration.diagnosis.search.warm_start.exchanged", there)
  exchange(pool, best)
  assert (
    pool.base.cost == pytest.approx(clean_pool.base.cost, rel=1e-3) and pool.models[frozenset(["side_force"])] is best
  )


def test_a_base_at_its_minimum_stays_within_a_nat(offset_pool):
  pool = dataclasses.replace(offset_pool, models=dict(offset_pool.models))
  level(pool, pool.models[frozenset(["steering_offset"])])
  assert offset_pool.base.cost - 1.0 < pool.base.cost <= offset_pool.base.cost


def test_sets_one_smaller_are_tried_and_kept_if_they_fit_better(offset_pool):
  pair = rig.solved(offset_pool.problem, ("side_force", "steering_offset"))
  key = frozenset(pair.mechanisms)
  pool = dataclasses.replace(offset_pool, models={frozenset(): offset_pool.base, key: pair})
  level(pool, pair)
  assert set(pool.models) == {frozenset(), frozenset(["side_force"]), frozenset(["steering_offset"]), key}
  exact = offset_pool.models[frozenset(["steering_offset"])]
  assert pool.models[frozenset(["steering_offset"])].cost == pytest.approx(exact.cost, rel=1e-3)


def test_all_that_the_best_holds_is_taken_to_what_it_found(offset_pool):
  """A single that stopped short would make the pair look like two effects, and the triple like three."""
  names = ("quadratic_drag", "side_force", "steering_offset")
  alone, pair = frozenset(["steering_offset"]), frozenset(names[1:])
  exact = offset_pool.models[alone]
  short = dataclasses.replace(exact, values=exact.values.copy(), theta=exact.theta.copy(), settled=True)
  short.values[short.free.index("torque_per_volt")] *= 1.3
  short.theta[offset_pool.problem.parameters.index("torque_per_volt")] *= 1.3
  simulate(offset_pool.problem, [short])
  triple, held = rig.solved(offset_pool.problem, names), candidate(offset_pool.problem, names[1:], short, rig.BASE)
  simulate(offset_pool.problem, [held])
  models = {frozenset(): offset_pool.base, alone: short, pair: held, frozenset(names): triple}
  pool = dataclasses.replace(offset_pool, models=models)
  assert short.cost > exact.cost + 100.0
  level(pool, triple)
  assert pool.models[alone].cost == pytest.approx(exact.cost, abs=1.0)
  assert pool.models[pair].cost <= pool.models[alone].cost
  assert pool.models[frozenset(names)].cost <= min(m.cost for key, m in pool.models.items() if len(key) < 3)


def test_a_set_begins_at_each_smaller_one_that_brings_something(offset_pool):
  """What one name has bent another may need straight; of those that bring nothing the best is enough."""
  models = {k: m for k, m in offset_pool.models.items() if len(k) < 2}
  pool = dataclasses.replace(offset_pool, models=models)
  at = lambda key: [(one.parent.mechanisms, one.apart) for one in begin_sets(pool, [key]) if one.key == key]
  assert at(frozenset(["quadratic_drag", "steering_offset"])) == [(("steering_offset",), False)]
  assert pool.base.cost - pool.models[frozenset(["side_force"])].cost > 20.0
  both = at(frozenset(["side_force", "steering_offset"]))
  assert both == [(("steering_offset",), False), (("side_force",), True)]


def test_a_search_from_a_base_that_strayed_stops_and_begins_anew_from_the_lower_minimum(clean_pool):
  """What was fitted from a wrong place would be worth all the nats that place is too high."""
  problem, lost = clean_pool.problem, astray(clean_pool, 0.3).base
  baseline = dataclasses.replace(
    rig.baseline_of(problem, lost), theta=lost.theta, fit=SimpleNamespace(parameters=rig.BASE, theta=lost.values)
  )
  promising = {n: dataclasses.replace(s, gain=30.0) for n, s in clean_pool.signatures.items()}
  pool = search(baseline, lost, promising)
  assert pool.base_not_converged and pool.base.cost < lost.cost - 100.0
  assert {len(key) for key in pool.models} <= {0, 1}
  again = recalibrate_from(baseline, pool.base.theta)
  np.testing.assert_allclose(again.fit.theta, clean_pool.base.values, rtol=0.02)
  base = base_candidate(again)
  assert not search(again, base, scan(again.problem, base, problem.twin.mechanisms)).base_not_converged


def test_rivals_left_at_a_higher_place_are_brought_along(offset_pool):
  """Without it a rival's gain over a base that came down would be negative, which no larger model's can be."""
  problem, best = offset_pool.problem, offset_pool.models[frozenset(["steering_offset"])]
  left = {}
  for name in ("side_force", "quadratic_drag"):
    model = offset_pool.models[frozenset([name])]
    model = dataclasses.replace(model, values=model.values.copy(), theta=model.theta.copy(), settled=False)
    model.values[model.free.index("torque_per_volt")] *= 1.3
    model.theta[problem.parameters.index("torque_per_volt")] *= 1.3
    simulate(problem, [model])
    assert model.cost > offset_pool.base.cost + 100.0
    left[frozenset([name])] = model
  pool = dataclasses.replace(offset_pool, models=offset_pool.models | left)
  level(pool, best)
  for key in left:
    assert pool.models[key].cost == pytest.approx(offset_pool.models[key].cost, abs=2.0)
    assert pool.models[key].cost <= pool.base.cost
  assert pool.models[frozenset(["steering_offset"])] is best


def test_a_promise_that_a_refit_broke_is_tried_with_fresh_columns(offset_pool):
  """A base whose columns are wrong leads every refit nowhere; what the scan promised is found all the same."""
  problem, name = offset_pool.problem, "steering_offset"
  key, exact = frozenset([name]), offset_pool.models[frozenset(["steering_offset"])]
  stale = dataclasses.replace(offset_pool.base, jacobian=-offset_pool.base.jacobian)
  broken = candidate(problem, (name,), stale, offset_pool.priors)
  simulate(problem, [broken])
  models = {frozenset(): stale, key: broken}
  pool = dataclasses.replace(offset_pool, models=models)
  assert pool.signatures[name].gain > 50.0 and broken.cost == pytest.approx(stale.cost)
  refine_stalled(pool)
  assert pool.models[key].cost == pytest.approx(exact.cost, abs=1.0)
  kept = dataclasses.replace(offset_pool, models=offset_pool.models | {})
  refine_stalled(kept)
  assert kept.models[key] is offset_pool.models[key]


def begun_short(pool, *sizes):
  """A pool of singles that have only been begun, at shares of what they have at their minima: {name: share}."""
  models = {frozenset(): dataclasses.replace(pool.base, jacobian=pool.base.jacobian.copy())}
  for name, share in sizes:
    start = {name: share * pool.models[frozenset([name])].estimate(name)[0]}
    models[frozenset([name])] = candidate(pool.problem, (name,), pool.base, pool.priors, start)
  simulate(pool.problem, [m for key, m in models.items() if key])
  return dataclasses.replace(pool, models=models)


def test_singles_that_explain_enough_are_taken_to_their_minima(offset_pool, monkeypatch):
  """The weaker of two that stopped short may be the stronger at its minimum."""
  monkeypatch.setattr("calibration.diagnosis.search.structure._NEAR", 0.0)
  pool = begun_short(offset_pool, ("steering_offset", 0.3), ("side_force", 0.0))
  refine_leaders(pool)
  for key in (frozenset(["steering_offset"]), frozenset(["side_force"])):
    assert pool.models[key].cost == pytest.approx(offset_pool.models[key].cost, abs=1.0)
  assert pool.base.cost == pytest.approx(offset_pool.base.cost, abs=1.0)


def test_what_is_far_behind_does_not_race(offset_pool):
  best, far = frozenset(["steering_offset"]), frozenset(["side_force"])
  pool = begun_short(offset_pool, ("steering_offset", 0.5), ("side_force", 0.0))
  before = pool.models[far].cost
  refine_leaders(pool)
  assert pool.models[best].cost == pytest.approx(offset_pool.models[best].cost, abs=1.0)
  assert pool.models[far].cost == before


def test_nobody_races_where_nothing_is_to_be_won(clean_pool):
  pool = begun_short(clean_pool, ("gyro_scale", 0.5), ("side_force", 0.0))
  before = {key: model.cost for key, model in pool.models.items()}
  refine_leaders(pool)
  assert {key: model.cost for key, model in pool.models.items()} == before


def test_a_start_may_leave_the_base_where_it_is(offset_pool, monkeypatch):
  """Where the way in which the base would meet an effect is wrong, the effect alone is the better beginning."""
  name, key = "steering_offset", frozenset(["steering_offset"])
  signature = offset_pool.signatures[name]
  wrong = dataclasses.replace(signature, answer=dict.fromkeys(signature.answer, 0.0) | {"torque_per_volt": 60.0})
  pool = dataclasses.replace(
    offset_pool, models={frozenset(): offset_pool.base}, signatures=offset_pool.signatures | {name: wrong}
  )
  (begun,) = [one.model for one in begin_sets(pool, [key])]
  assert begun.estimate("torque_per_volt")[0] == offset_pool.base.estimate("torque_per_volt")[0]
  assert begun.estimate(name)[0] == pytest.approx(signature.start[name])
  assert begun.cost < offset_pool.base.cost


def test_models_of_an_earlier_search_go_on_from_where_they_ended(offset_pool):
  problem, name = offset_pool.problem, "steering_offset"
  exact = offset_pool.models[frozenset([name])]
  earlier = dataclasses.replace(exact, values=exact.values.copy())
  earlier.values[earlier.free.index("torque_per_volt")] *= 1.1
  pool = dataclasses.replace(offset_pool, models={frozenset(): offset_pool.base})
  warm_start(pool, [offset_pool.base, earlier])
  assert set(pool.models) == {frozenset(), frozenset([name])}
  assert pool.models[frozenset([name])].cost == pytest.approx(exact.cost, abs=1.0)
  assert pool.base is offset_pool.base and problem is pool.problem


def test_a_model_is_offered_to_a_pool_that_keeps_the_better(offset_pool):
  key = frozenset(["side_force"])
  held, base = offset_pool.models[key], offset_pool.base
  pool = dataclasses.replace(offset_pool, models=dict(offset_pool.models))
  pool.offer(dataclasses.replace(held, residual=1.1 * held.residual))
  assert pool.models[key] is held
  better = dataclasses.replace(held, residual=0.9 * held.residual)
  pool.offer(better)
  assert pool.models[key] is better
  pool = dataclasses.replace(offset_pool, models={frozenset(): base})
  pool.offer(dataclasses.replace(held, residual=2.0 * base.residual))
  assert pool.models[key].cost == pytest.approx(base.cost)  # the base's estimates with the mechanism at its null


def test_what_bends_is_refitted_whatever_the_scan_says(offset_pool, monkeypatch):
  problem = offset_pool.problem
  baseline = rig.baseline_of(problem, offset_pool.base)
  baseline = dataclasses.replace(baseline, fit=SimpleNamespace(parameters=rig.BASE))
  effort = Effort(singles=1, pairs=0, triples=0)

  def refitted():
    pool = search(baseline, rig.solved(problem), offset_pool.signatures, effort)
    return {name for model in pool.of_size(1) for name in model.mechanisms}

  assert refitted() == {"steering_offset"}
  monkeypatch.setattr(type(problem.mechanism("quadratic_drag")), "nonlinear_response", True)
  assert refitted() == {"steering_offset", "quadratic_drag"}


def test_an_amplitude_that_would_have_to_be_negative_promises_nothing(offset_pool, monkeypatch):
  """A trim to the left explains a car that turns left; one that could only be to the right does not."""
  signature = offset_pool.signatures["steering_offset"]
  assert _explains(offset_pool, offset_pool.base)["steering_offset"] > 50.0
  monkeypatch.setattr(type(offset_pool.problem.mechanism("steering_offset")), "signed", False)
  assert _explains(offset_pool, offset_pool.base)["steering_offset"] > 50.0
  opposite = dataclasses.replace(signature, direction=-signature.direction)
  pool = dataclasses.replace(offset_pool, signatures=offset_pool.signatures | {"steering_offset": opposite})
  assert _explains(pool, pool.base)["steering_offset"] == 0.0


def test_a_set_that_lost_much_with_a_trifle_is_fitted_from_where_the_trifle_led(offset_pool):
  """A trim left at a third of its size, and a drag of nothing with which it found the whole: the drag is no reason."""
  key, exact = frozenset(["steering_offset"]), offset_pool.models[frozenset(["steering_offset"])]
  third = {"steering_offset": exact.estimate("steering_offset")[0] / 3.0}
  stuck = candidate(offset_pool.problem, ("steering_offset",), offset_pool.base, rig.BASE, third)
  simulate(offset_pool.problem, [stuck])
  pair = rig.solved(offset_pool.problem, ("quadratic_drag", "steering_offset"))
  pool = dataclasses.replace(offset_pool, models={frozenset(): offset_pool.base, key: stuck})
  assert stuck.cost - pair.cost > 50.0
  pool.models[frozenset(pair.mechanisms)] = pair
  _without_trifles(pool)
  assert pool.models[key].cost == pytest.approx(exact.cost, rel=1e-3)


def test_beside_a_name_beyond_doubt_what_bends_is_tried_whatever_the_scan_promised(
  offset_pool, clean_pool, monkeypatch
):
  monkeypatch.setattr(type(offset_pool.problem.mechanism("quadratic_drag")), "nonlinear_response", True)
  found, bending = _nominate_pairs(offset_pool, 0), frozenset(["quadratic_drag", "steering_offset"])
  assert found == [bending]
  silent = {n: dataclasses.replace(s, gain=0.0) for n, s in offset_pool.signatures.items()}
  assert bending in _nominate_pairs(dataclasses.replace(offset_pool, signatures=silent), 5)
  assert len(set(found := _nominate_pairs(offset_pool, 50))) == len(found)
  # nothing is beyond doubt where there is no effect, and an untestable one is never tried
  assert _nominate_pairs(clean_pool, 0) == []
  blind = {n: dataclasses.replace(s, shown=0.0) for n, s in offset_pool.signatures.items()}
  assert _nominate_pairs(dataclasses.replace(offset_pool, signatures=blind), 5) == []


def test_what_these_channels_cannot_show_leaves_nothing_to_search_for(clean_pool):
  """However much of the error it would explain: nothing was refitted that broke a promise."""
  blind = dataclasses.replace(clean_pool.signatures["side_force"], shown=0.0, gain=500.0)
  pool = dataclasses.replace(clean_pool, models={frozenset(): clean_pool.base}, signatures={"side_force": blind})
  refine_stalled(pool)
  assert list(pool.models) == [frozenset()]
