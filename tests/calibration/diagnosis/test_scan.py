"""The scan on a linear car: what the base can imitate vanishes, what is left is the gain of the exact refit."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calibration.diagnosis.candidates import candidate, refine, simulate
from calibration.diagnosis.scan import Projector, at_bound, confusion, scan, trial_starts
from calibration.fitting.observations import CHANNELS
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms import select
from tests.calibration.diagnosis import diagnosis_rig as rig

DRIVING = Driving(0.0, 130.0, np.random.default_rng(0).normal(0.0, 1.0, (300, 2)))


def test_projection_removes_what_the_base_parameters_imitate(offset_pool):
  base = offset_pool.base
  project = Projector(base)
  imitated = (base.jacobian @ (np.arange(1, 1 + len(base.free)) * 0.1 * base.free.scale))[: base.n_train]
  assert np.linalg.norm(project(imitated[None])) < 0.03 * np.linalg.norm(imitated)
  free = np.arange(3)  # without a measured prior there is nothing that holds these back
  alone = (base.jacobian[:, free] @ base.free.scale[free])[: base.n_train]
  assert np.linalg.norm(project(alone[None])) < 2e-3 * np.linalg.norm(alone)


def test_projection_leaves_what_no_base_parameter_does(offset_pool):
  base = offset_pool.base
  change = np.zeros(base.n_train)
  seen = base.jacobian[: base.n_train]
  random = np.random.default_rng(0).standard_normal(base.n_train)
  change = random - seen @ np.linalg.lstsq(seen, random, rcond=None)[0]
  assert_allclose(Projector(base)(change[None])[0], change, atol=1e-8)


def test_gain_of_the_truth_equals_the_drop_of_the_exact_refit(offset_pool):
  exact = offset_pool.base.cost - offset_pool.models[frozenset(["steering_offset"])].cost
  assert offset_pool.signatures["steering_offset"].gain == pytest.approx(exact, rel=1e-3)
  assert exact > 100


def test_what_was_measured_tells_of_an_effect_that_recalibration_imitates():
  """A gyro that reads 7.5 % too much passes for a stiffness that is not what was measured; nothing else shows it."""
  twin = rig.LinearTwin(("gyro_scale",))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"gyro_scale": 0.075}))
  measured = rig.BASE.replace(
    cornering_stiffness_front=dataclasses.replace(rig.BASE["cornering_stiffness_front"], std=0.05)
  )
  base = candidate(problem, (), None, measured)
  simulate(problem, [base])
  refine(problem, [base], 3, full=True)
  found = scan(problem, base, twin.mechanisms)["gyro_scale"]
  refit = candidate(problem, ("gyro_scale",), base, measured)
  simulate(problem, [refit])
  refine(problem, [refit], 3, full=True)
  assert base.cost - refit.cost > 10.0 and found.unabsorbed_share < 0.1
  assert found.gain == pytest.approx(base.cost - refit.cost, rel=0.02)
  assert found.start["gyro_scale"] == pytest.approx(refit.estimate("gyro_scale")[0], rel=0.02)


@pytest.mark.parametrize("scale", [-0.075, 0.075])
def test_what_every_model_tolerates_is_sized_from_where_the_base_has_stopped(scale):
  """A gyro is allowed for within 2 %, and reads 7.5 % too much or too little: beyond that, not on the other side."""
  twin = rig.LinearTwin(("gyro_scale",))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"gyro_scale": scale}))
  allowed = dataclasses.replace(twin.parameters["gyro_scale"], lower=-0.02, upper=0.02, std=0.007, assumed=True)
  stiff = {n: dataclasses.replace(rig.BASE[n], std=1e-3 * rig.BASE[n].nominal) for n in rig.BASE.names}
  base = candidate(problem, (), None, rig.BASE.replace(**stiff) + [allowed])
  simulate(problem, [base])
  refine(problem, [base], 3, full=True)
  assert base.estimate("gyro_scale")[0] == pytest.approx(np.sign(scale) * 0.02, rel=1e-3)
  found = scan(problem, base, twin.mechanisms)["gyro_scale"]
  assert found.start["gyro_scale"] == pytest.approx(scale, rel=0.1)  # 23 nats: known to 14 %


def test_what_needs_a_channel_that_was_not_measured_is_untestable(offset_pool, monkeypatch):
  """A ripple over turns of the wheels without an encoder was claimed on a car that had only its speed logged."""
  problem = offset_pool.problem
  kind = type(problem.mechanism("steering_offset"))
  seen = scan(problem, offset_pool.base, [problem.mechanism("steering_offset")])["steering_offset"]
  assert seen.testable
  monkeypatch.setattr(kind, "needs", ("yaw_rate",))
  assert scan(problem, offset_pool.base, [problem.mechanism("steering_offset")])["steering_offset"].testable
  monkeypatch.setattr(kind, "needs", ("yaw_rate", "speed"))
  assert scan(problem, offset_pool.base, [problem.mechanism("steering_offset")])["steering_offset"].testable, "motor's"
  monkeypatch.setattr(kind, "needs", ("yaw_rate", "battery_voltage"))
  blind = scan(problem, offset_pool.base, [problem.mechanism("steering_offset")])["steering_offset"]
  assert not blind.testable and blind.gain == pytest.approx(seen.gain)


def test_an_effect_does_not_hide_by_the_misfit_it_makes(offset_pool):
  """A pose turned by 5 degrees left a channel 23 times its noise; at that weight it counted as never shown."""
  problem, mechanism = offset_pool.problem, offset_pool.problem.mechanism("steering_offset")
  seen = scan(problem, offset_pool.base, [mechanism])["steering_offset"]
  weighting = dataclasses.replace(problem.weighting, std=1e3 * problem.weighting.std)
  heavy = problem.reweighted(weighting)
  base = rig.solved(heavy)
  noise = {name: s for name, s in zip(CHANNELS, problem.weighting.std, strict=True) if np.isfinite(s)}
  assert not scan(heavy, base, [mechanism])["steering_offset"].testable
  found = scan(heavy, base, [mechanism], noise=noise)["steering_offset"]
  assert found.testable and found.shown == pytest.approx(seen.shown, rel=0.2)


def test_a_concealed_effect_is_untestable_not_absent(offset_pool):
  concealed = offset_pool.signatures["gyro_scale"]  # on this car it is the cornering stiffness by another name
  assert not concealed.testable
  assert concealed.unabsorbed_share < 1e-6
  assert offset_pool.signatures["steering_offset"].testable
  assert offset_pool.signatures["steering_offset"].unabsorbed_share > 0.9


def test_gain_is_never_negative_and_signs_are_respected(offset_pool):
  assert offset_pool.signatures["quadratic_drag"].start["quadratic_drag"] > 0
  assert all(s.gain >= 0 for s in offset_pool.signatures.values())


@pytest.mark.parametrize("truth", [0.03, -0.03])
def test_the_start_has_the_sign_and_size_of_the_truth(truth):
  twin = rig.LinearTwin(("steering_offset",))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"steering_offset": truth}))
  found = scan(problem, rig.solved(problem), twin.mechanisms)["steering_offset"]
  assert found.start["steering_offset"] == pytest.approx(truth, abs=0.5 * abs(truth))


def test_trials_stay_in_bounds_and_cover_every_amplitude():
  for mechanism in select(["side_force", "gyro_bias", "steering_lag", "quadratic_drag"]):
    starts = trial_starts(mechanism, (0.3, 0.8, 1.6), DRIVING)
    declared = {p.name: p for p in mechanism.parameters}
    for start in starts:
      assert all(declared[n].lower <= v <= declared[n].upper for n, v in start.items())
    amplitudes = {p.name for p in mechanism.parameters if p.null is not None}
    assert amplitudes <= {name for start in starts for name in start}


def test_grip_that_changes_is_tried_both_ways_at_one_size():
  (change,) = select(["friction_change"])
  sizes = [start["friction_change"] for start in trial_starts(change, (0.3, 0.8, -0.3, -0.8), DRIVING)]
  places = len(change.initial_guesses(DRIVING))
  assert (
    places > 1 and len(sizes) == 2 * places and sum(sizes) == pytest.approx(0.0) and sum(s > 0 for s in sizes) == places
  )


def test_confusion_names_effects_that_look_alike():
  twin = rig.LinearTwin(("steering_offset", "side_force"))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"steering_offset": 0.02}))
  base = rig.solved(problem)
  signatures = scan(problem, base, twin.mechanisms)
  assert "side_force" not in confusion(signatures).get("steering_offset", {})
  twice = {"one": signatures["side_force"], "other": signatures["side_force"]}
  assert confusion(twice) == {"one": {"other": pytest.approx(1.0)}, "other": {"one": pytest.approx(1.0)}}
  nowhere = dataclasses.replace(twice["one"], direction=np.zeros_like(twice["one"].direction))
  with np.errstate(all="raise"):
    assert confusion(twice | {"nowhere": nowhere}) == confusion(twice) | {"nowhere": {}}


def test_what_stands_at_its_bound_imitates_nothing(offset_pool):
  free = offset_pool.base
  column = free.free.index("cornering_stiffness_front")
  change = free.jacobian[: free.n_train, column][None]
  assert np.linalg.norm(Projector(free)(change)) < 0.01 * np.linalg.norm(change)
  stopped = dataclasses.replace(free, values=free.values.copy())
  stopped.values[column] = stopped.free.lower[column]
  assert at_bound(stopped).tolist() == [name == "cornering_stiffness_front" for name in free.free.names]
  rest = Projector(stopped)(change)
  assert np.linalg.norm(rest) > 0.3 * np.linalg.norm(change)
  assert Projector(stopped).answer(change)[0, column] == 0.0


def ruled_base(problem):
  """A recalibrated car that may use up a gyro scale of 3 % within a prior of 1 %."""
  ruled = rig.BASE + [dataclasses.replace(problem.parameters["gyro_scale"], std=0.01, lower=-0.03, upper=0.03)]
  base = candidate(problem, (), None, ruled)
  simulate(problem, [base])
  refine(problem, [base], 3, full=True)
  return base, ruled


def test_a_mechanism_frees_what_a_ruler_holds(offset_pool):
  """In its own model the parameter has neither the ruler's prior nor its bounds, and is there once."""
  base, ruled = ruled_base(offset_pool.problem)
  model = candidate(offset_pool.problem, ("gyro_scale",), base, ruled)
  assert sorted(model.free.names) == sorted(ruled.names)
  assert model.free["gyro_scale"] == offset_pool.problem.parameters["gyro_scale"]
  assert model.estimate("gyro_scale")[0] == base.estimate("gyro_scale")[0]


def test_what_a_ruler_holds_does_not_imitate_its_own_mechanism(offset_pool):
  """The signature is that of a base without the parameter; every other mechanism's has it projected out."""
  base, _ = ruled_base(offset_pool.problem)
  found = scan(offset_pool.problem, base, offset_pool.problem.twin.mechanisms)
  plain = scan(offset_pool.problem, offset_pool.base, offset_pool.problem.twin.mechanisms)
  assert found["gyro_scale"].shown == pytest.approx(plain["gyro_scale"].shown, rel=0.02)
  assert found["steering_offset"].shown <= plain["steering_offset"].shown + 1e-9
