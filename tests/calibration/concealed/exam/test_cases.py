"""A case is decided by its digest, is as large as was drawn, and is written before anybody answers."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from calibration.concealed.exam.cases import Case, draw_cases, effects_of, make_case
from calibration.concealed.exam.effects import Concealed, Effect
from calibration.concealed.exam.nats import Judge, sized
from calibration.concealed.exam.session import make_exam_session, set_up
from calibration.concealed.exam.slipx_car import SlipxCar
from calibration.concealed.exam.slipx_effects import slipx_nuisances
from tests.calibration.concealed.proving_ground.comparing import same


def test_cases_keep_the_mix_and_say_nothing_by_name_or_order():
  cases = draw_cases("slipx", "some commit", 105)
  assert Counter(c.kind for c in cases) == {"null": 40, "single": 40, "pair": 15, "outside": 10}
  assert cases == draw_cases("slipx", "some commit", 105) != draw_cases("slipx", "another", 105)
  assert [c.name for c in cases] == [f"case_{i:03d}" for i in range(105)]
  assert len({c.kind for c in cases[:15]}) >= 3 and len({c.seed for c in cases}) == 105
  table, singles = effects_of("slipx"), [c.effects[0] for c in cases if c.kind == "single"]
  known = {name for name, effect in table.items() if effect.right}
  assert set(singles) == known, "every effect is concealed before one comes again"
  assert all(not table[c.effects[0]].right for c in cases if c.kind == "outside")


@pytest.fixture(scope="module")
def judge():
  """Of every other run."""
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  whole = set_up("slipx", 7, bench=True)
  return Judge.of(dataclasses.replace(whole, runs=whole.runs[::2], shaking=whole.shaking[:, :, ::2]))


@pytest.mark.slow
def test_what_a_recalibration_may_move_is_no_effect(judge):
  wear = slipx_nuisances(judge.setting.std, judge.setting.car.params)["rolling resistance"]
  shown = judge.shown([Concealed("wear", Effect("drive", "parameter", (), "-", 1.0, wear.act), 0.02)])
  assert shown.before > 100.0 and shown.nats < 0.01 * shown.before
  assert judge.shown([]).nats == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "target"), [("gyro_gain", 50.0), ("drag", 400.0)])
def test_a_size_shows_the_nats_that_were_drawn(judge, name, target):
  concealed, shown = sized(judge, name, effects_of("slipx")[name], 1.0, target)
  assert shown.nats == pytest.approx(target, rel=0.1)
  twice = judge.shown([Concealed(name, concealed.effect, 2.0 * concealed.size)])
  assert twice.nats == pytest.approx(4.0 * shown.nats, rel=0.2)


@pytest.mark.slow
def test_numbers_that_drive_along_take_up_more_than_their_slopes_promise(judge):
  """A payload is a mass, a centre of gravity and an inertia, which all may be moved, but not in a straight line."""
  payload = Concealed("payload", effects_of("slipx")["payload"], 0.4)
  straight, driven = judge.shown([payload]), judge.absorbed([payload])
  assert driven.before == straight.before > 1e4
  assert 0.0 < driven.nats < 0.5 * straight.nats
  small = Concealed("gyro_gain", effects_of("slipx")["gyro_gain"], 0.01)
  assert judge.absorbed([small]).nats == pytest.approx(judge.shown([small]).nats, rel=0.05, abs=0.5)


@pytest.mark.slow
def test_nats_of_a_gyro_that_reads_too_much_are_those_of_its_samples_that_are_not_held_out(judge):
  runs = zip(judge.setting.runs, judge.plain, strict=True)
  rates = np.concatenate([plain["yaw_rate"] for run, plain in runs if run.role != "holdout"])
  shown = judge.shown([Concealed("gyro_gain", effects_of("slipx")["gyro_gain"], 0.01)])
  assert shown.before == pytest.approx(0.5 * np.sum((0.01 * rates / 0.003) ** 2) / 10.0, rel=1e-9)


@pytest.mark.slow
def test_the_same_case_is_the_same_bytes_and_holds_what_its_truth_says(monkeypatch):
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  whole = SlipxCar.runs
  monkeypatch.setattr(SlipxCar, "runs", lambda car, rng: whole(car, rng)[::3])
  case = Case("case_000", "single", "slipx", 11, ("steering_dead_time",))
  (session, truth), (again, told) = make_case(case), make_case(case)
  assert same(session, again) and truth == told
  (effect,) = truth["effects"]
  assert effect["right"] == ["steering_delay"]
  assert effect["nats_first_order"] == pytest.approx(effect["nats_wanted"], rel=0.25)
  assert 0.0 < effect["nats"] < effect["nats_before_absorption"]
  assert session.vehicle_std["servo_time_constant"] == pytest.approx(0.0015)
  assert not same(session, make_exam_session("slipx", 11, bench=True))
