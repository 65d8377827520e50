"""The next experiment: its promise is what a refit on it would show, and it is asked for only where names are open."""

import dataclasses
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from calibration.diagnosis.experiment import (
  NOTHING,
  DrivenRange,
  Manoeuvre,
  manoeuvres,
  next_experiment,
  predicted_nats,
  reach,
  to_separate,
)
from qcar_twin.vehicle.drive import DRIVES
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.diagnosis_results import decided

REACH = DrivenRange(command=8.0, slow=0.3, fast=0.8, angle=0.3)


def models(pool, one, other):
  return pool.models[frozenset([one])], pool.models[frozenset([other])]


def test_a_model_cannot_be_told_from_itself(offset_pool):
  model, _ = models(offset_pool, "steering_offset", "side_force")
  assert_allclose(predicted_nats(offset_pool.problem, model, model, manoeuvres(REACH)), 0.0, atol=1e-9)


def test_the_promise_is_what_a_refit_of_the_rival_would_leave(offset_pool):
  """The car is linear: half the squares that are left once the rival was refitted to old and new data."""
  model, rival = models(offset_pool, "steering_offset", "side_force")
  problem, library = offset_pool.problem, manoeuvres(REACH)[:3]
  promised = predicted_nats(problem, model, rival, library)
  time = np.arange(0.0, 8.0 - 1e-9, 0.01)
  for manoeuvre, nats in zip(library, promised, strict=True):
    streams = {name: rig.Stream(np.append(time, 8.0), np.zeros(801)) for name in rig.NOISE}
    streams["motor_voltage"] = rig.Stream(time, manoeuvre.commands[:, 0])
    streams["steering_command"] = rig.Stream(time, manoeuvre.commands[:, 1])
    driven = rig.problem_of(problem.twin, [rig.Recording("new", streams)])
    thetas = np.tile(rival.theta, (len(rival.free) + 1, 1))
    for i, name in enumerate(rival.free.names):
      thetas[i + 1, problem.parameters.index(name)] += rival.free.scale[i]
    # ten samples of the new recording count as one witness
    target = driven.residual(model.theta[None])[0] / np.sqrt(10.0)
    seen = driven.residual(thetas) / np.sqrt(10.0)
    columns = ((seen[1:] - seen[0]) / rival.free.scale[:, None]).T
    old = np.linalg.cholesky(rival.curvature).T
    stacked = np.vstack([columns, old])
    wanted = np.concatenate([target - seen[0], np.zeros(len(old))])
    left = wanted - stacked @ np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    assert_allclose(nats, 0.5 * left @ left, rtol=1e-6)


def test_longer_known_rivals_bend_less(offset_pool):
  model, rival = models(offset_pool, "steering_offset", "gyro_scale")
  stiff = dataclasses.replace(rival, jacobian=10.0 * rival.jacobian)
  library = manoeuvres(REACH)
  assert np.all(
    predicted_nats(offset_pool.problem, model, stiff, library)
    >= predicted_nats(offset_pool.problem, model, rival, library) - 1e-9
  )


def test_an_effect_of_the_steering_is_not_looked_for_on_a_straight_line(clean_pool):
  """A gyro's scale error shows where the car turns."""
  problem, base = clean_pool.problem, clean_pool.base
  model = rig.solved(problem, ("gyro_scale",))
  model.theta[problem.parameters.index("gyro_scale")] = 0.2
  library = manoeuvres(REACH)
  worth = predicted_nats(problem, model, base, library)
  turning = np.array([np.abs(m.commands[:, 1]).max() > 0 for m in library])
  assert worth[turning].min() > 10.0 * max(worth[~turning].max(), 0.1)


def test_the_library_stays_within_what_was_driven():
  for manoeuvre in manoeuvres(REACH):
    assert isinstance(manoeuvre, Manoeuvre) and manoeuvre.commands.shape == (800, 2)
    assert np.abs(manoeuvre.commands[:, 0]).max() <= REACH.command * REACH.fast * (1 + 1e-12)
    assert np.abs(manoeuvre.commands[:, 1]).max() <= REACH.angle * (1 + 1e-12)
  assert len({m.about for m in manoeuvres(REACH)}) == len(manoeuvres(REACH))


def test_reach_is_read_off_the_recordings(clean_pool):
  found = reach(clean_pool)
  commands = clean_pool.problem.observations.stretches.segments.commands
  assert 0.1 <= found.angle <= np.abs(commands[..., 1]).max()
  assert found.slow < found.fast and found.command > 0 and found.unit == "V"


def test_certain_names_need_no_experiment_and_doubtful_ones_do(offset_pool, clean_pool):
  decision = decided(offset_pool)
  claim = decision.claims[0]
  sure = dataclasses.replace(
    decision, claims=(dataclasses.replace(claim, probability=0.95, indistinguishable_from=()),)
  )
  assert to_separate(offset_pool, sure) is None and next_experiment(offset_pool, sure) is None
  unsure = dataclasses.replace(decision, claims=(dataclasses.replace(claim, probability=0.6),))
  asked = next_experiment(offset_pool, unsure)
  assert asked is not None and asked["separates"][0] == claim.mechanism
  assert asked["separates"][1] == claim.alternatives[0][0] and asked["predicted_nats"] > 0
  nothing = decided(clean_pool)
  possible = dataclasses.replace(nothing, claims=(), possible=("side_force",))
  names, _, rival = to_separate(clean_pool, possible)
  assert names == ("side_force", NOTHING) and rival is clean_pool.base


def test_a_manoeuvre_on_which_a_model_flies_apart_is_not_proposed(offset_pool, monkeypatch):
  decision = decided(offset_pool)
  unsure = dataclasses.replace(decision, claims=(dataclasses.replace(decision.claims[0], probability=0.6),))
  worth = np.full(len(manoeuvres(REACH)), np.nan)
  monkeypatch.setattr("calibration.diagnosis.experiment.predicted_nats", lambda *args: worth)
  assert next_experiment(offset_pool, unsure) is None
  worth[:3] = 5.0, np.inf, 7.0
  assert next_experiment(offset_pool, unsure)["predicted_nats"] == 7.0


def test_a_car_driven_by_duty_is_promised_the_same(offset_pool, monkeypatch):
  """What drives the motor is another channel, and nothing else differs."""
  model, rival = models(offset_pool, "steering_offset", "side_force")
  promised = predicted_nats(offset_pool.problem, model, rival, manoeuvres(REACH))
  duty = {"motor": DRIVES["duty"], "commands": (DRIVES["duty"].channel, "steering_command"), "drive": "duty"}
  monkeypatch.setattr(offset_pool.problem.twin, "vehicle", SimpleNamespace(**(vars(rig.VEHICLE) | duty)))
  assert_allclose(predicted_nats(offset_pool.problem, model, rival, manoeuvres(REACH)), promised)
  assert reach(offset_pool).unit == "-"
  assert any("of full duty" in m.about for m in manoeuvres(dataclasses.replace(REACH, unit="-")))
