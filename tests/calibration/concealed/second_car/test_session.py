"""Sessions of the second car: the seed decides, noise and effects leave each other alone."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calibration.concealed.campaign.cases import draw_second_cases
from calibration.concealed.campaign.run import MAKERS
from calibration.concealed.laboratory.designs import plan
from calibration.concealed.second_car import SECOND_EFFECTS, make_second_session
from calibration.concealed.second_car import session as driven
from calibration.concealed.second_car.sensing import POSE_EVERY
from qcar_twin.recordings.dataset import DataSet
from tests.calibration.concealed.proving_ground.comparing import differences, same

RUNS = ("voltage_steps_other", "figure_eight")


@pytest.fixture(autouse=True)
def two_short_runs(monkeypatch):
  """The first 0.9 s of two manoeuvres of a design."""

  def short(design, rng):
    runs = [run for run in plan(design, rng) if run.name in RUNS]
    cut = lambda run: replace(run, steer=run.steer[:90], speed=run.speed[:90], volts=run.volts[:90])
    return [cut(run) for run in runs]

  monkeypatch.setattr(driven, "plan", short)


def test_the_seed_decides_every_bit():
  effects = (("steering_delay", 1.0), ("payload", 1.0))
  one, again, other = (make_second_session(seed, effects) for seed in (7, 7, 8))
  assert same(one, again)
  assert one.truth == again.truth
  assert one.vehicle != other.vehicle
  json.dumps(one.truth)


def test_an_effect_changes_what_it_should_and_not_the_noise():
  bare, biased = make_second_session(7), make_second_session(7, (("gyro_scale", 1.0),))
  changed = differences(bare, biased)
  assert changed.pop("yaw_rate") > 0.01
  assert np.nanmax(list(changed.values())) == 0.0
  assert bare.vehicle == biased.vehicle
  assert bare.truth["effects"] == []
  assert biased.truth["effects"][0]["parameters"] == {"gyro_scale": pytest.approx(0.05)}


def test_a_session_is_a_data_set():
  session = make_second_session(3)
  data = DataSet("second", session.recordings, session.vehicle, session.vehicle_std)
  assert [r.name for r in data.recordings] == list(RUNS)
  assert {r.role for r in data.recordings} == {"validate", "holdout"}
  for recording in data.recordings:
    assert session.clean[recording.name].shape == (90, len(session.truth["signals"]))
    assert len(recording["pose_x"].value) <= -(-90 // POSE_EVERY)
    assert len(recording["yaw_rate"].value) == 90
  speed = session.clean["figure_eight"][:, session.truth["signals"].index("vx")]
  assert speed.mean() == pytest.approx(0.9, abs=0.1)


def test_without_noise_the_sensors_read_the_truth():
  session = make_second_session(3, noise=0.0)
  for recording in session.recordings:
    clean = dict(zip(session.truth["signals"], session.clean[recording.name].T, strict=True))
    assert recording["yaw_rate"].value == pytest.approx(clean["yaw_rate"], abs=0.05)
    assert recording["motor_speed"].value == pytest.approx(clean["motor"], abs=6.0)
    assert recording["pose_x"].value == pytest.approx(clean["x"][::POSE_EVERY], abs=1e-3)


def test_designs_of_other_cars_are_refused():
  with pytest.raises(KeyError, match="does not drive the design 'wild'; valid are: compact, lab, paper"):
    make_second_session(1, design="wild")


def test_cases_are_drawn_from_a_seed():
  cases = draw_second_cases(4, 20, 20)
  assert cases == draw_second_cases(4, 20, 20)
  assert {case.car for case in cases} == {"second"} <= set(MAKERS)
  singles = [case for case in cases if case.kind == "single"]
  assert len({case.effects[0][0] for case in singles}) == 20
  assert {case.effects[0][0] for case in singles} <= set(SECOND_EFFECTS)
  assert all(0.85 <= abs(case.effects[0][1]) <= 1.25 for case in singles)
  assert len({case.seed for case in cases}) == 40
