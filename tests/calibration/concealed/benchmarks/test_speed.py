"""Benchmarks: turns are taken fairly, a pair says what it measured, and both fits are given the same problem."""

import re

import mujoco
import numpy as np
import pytest

from calibration.concealed.benchmarks import speed
from calibration.concealed.benchmarks.fit import CHANNELS, FITTED, TRUTH, RecompiledCar, edited, fit_pairs, make_task
from calibration.concealed.benchmarks.speed import Pair, overhead_pair, paired, threads_pair, tyre_pairs
from qcar_twin.twin.parameters import base_parameters
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import QCAR
from scripts import benchmark


@pytest.fixture(scope="module")
def task():
  return make_task(recordings=2, seconds=1.0)


def pair(ratio, at_most=True):
  return Pair("work", ("a", "b"), (ratio, 1.0), "car", ratio, 0.8, at_most, "busy")


def test_two_calls_take_turns_and_who_begins_changes():
  order, took = [], {"a": 4.0, "b": 1.0}
  clock = lambda: sum(took[who] for who in order)
  assert paired(lambda: order.append("a"), lambda: order.append("b"), 4, clock) == (4.0, 1.0, 4.0)
  assert "".join(order) == "ab" + "abba" * 2  # the first two calls are not timed


def test_the_ratio_is_of_rounds_so_a_slow_spell_hits_both_sides():
  lengths, spent = iter([0, 0, 1, 1, 8, 8, 1, 1, 8, 8]), [0.0]  # s; both sides are slow together
  step = lambda: spent.append(spent[-1] + next(lengths))
  assert paired(step, step, 4, lambda: spent[-1]) == (4.5, 4.5, 1.0)


def test_the_clock_is_the_one_asked_for():
  ticks = iter(range(100))
  assert paired(lambda: None, lambda: None, 4, clock=lambda: float(next(ticks))) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
  ("ratio", "at_most", "reached"),
  [(0.79, True, True), (0.81, True, False), (0.9, False, True), (0.7, False, False)],
)
def test_a_goal_is_reached_from_its_own_side(ratio, at_most, reached):
  measured = pair(ratio, at_most)
  assert measured.reached is reached
  assert ("MISSED" in str(measured)) is not reached
  assert (
    measured.aim == ("<= 0.8" if at_most else ">= 0.8") and measured.aim in str(measured) and "busy" in str(measured)
  )


def test_pairs_are_timed_in_the_order_they_are_named_and_per_unit(monkeypatch):
  def both_run(first, second, rounds, clock=None):
    first(), second()
    return 6.0, 3.0, 2.0

  monkeypatch.setattr(speed, "paired", both_run)
  overhead = overhead_pair(rounds=3, cars=16)
  assert overhead.sides == ("Simulation.step", "bare batch.step") and overhead.at_most and overhead.goal == 1.15
  threads, tyres = threads_pair(rounds=3, cars=16), tyre_pairs(rounds=3)[1]
  assert threads.sides == ("one thread", "two threads") and not threads.at_most and threads.goal == 1.8
  assert tyres.sides == ("tyre plugin", "native friction") and tyres.at_most and tyres.goal == 0.8
  for measured in (overhead, threads):
    assert measured.seconds == pytest.approx((6.0 / speed.PERIODS / 16, 3.0 / speed.PERIODS / 16))
  assert tyres.seconds == pytest.approx((6.0 / speed.STEPS, 3.0 / speed.STEPS))
  assert {measured.ratio for measured in (overhead, threads, tyres)} == {2.0}


@pytest.mark.parametrize("shares", [np.ones(len(FITTED)), TRUTH, np.array([0.8, 1.5, 1.4, 1.2, 0.8])])
def test_both_fits_have_the_same_residual(task, shares):
  ours, theirs = task.residual(shares[None])[0], RecompiledCar(task).residual(shares)
  assert ours.size == 2 * 100 * len(CHANNELS)
  assert np.abs(ours - theirs).max() < 1e-3  # of a standard deviation


def test_columns_of_the_recompiled_car_equal_single_calls(task):
  car = RecompiledCar(task)
  points = np.column_stack([np.ones(len(FITTED)), TRUTH])
  both = car.residual(points)
  assert np.array_equal(both[:, 1], car.residual(TRUTH)) and np.array_equal(both[:, 0], car.residual(np.ones(5)))


def test_the_truth_costs_half_a_nat_per_sample(task):
  residual = task.residual(TRUTH[None])[0]
  assert 0.5 * np.sum(residual**2) == pytest.approx(0.5 * residual.size, rel=0.15)
  assert 0.5 * np.sum(task.residual(np.ones((1, len(FITTED)))) ** 2) > 20 * residual.size


def test_edited_models_carry_the_numbers():
  model = edited(car_spec(QCAR, timestep=0.005), TRUTH).compile()
  plain = car_spec(QCAR, timestep=0.005).compile()
  chassis = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "chassis")
  wanted = 0.15 * QCAR.yaw_inertia
  yaw = [m.body_inertia[chassis].max() for m in (model, plain)]
  assert yaw[0] - yaw[1] == pytest.approx(wanted, rel=1e-6)
  assert {name for name in FITTED} <= set(base_parameters(QCAR).names)
  motor = model.joint("motor").dofadr[0]
  assert model.dof_frictionloss[motor] == pytest.approx(0.7 * QCAR.driveline_friction)


@pytest.fixture(scope="module")
def fits():
  return fit_pairs(2, 1.0, 0)


def test_all_fits_come_to_the_same_cost(fits):
  whole, same, confirmed = fits
  costs = [float(word) for word in whole.note.split(",")[0].replace("costs ", "").split(" and ")]
  assert costs[0] == pytest.approx(costs[1], rel=0.02)
  assert same.seconds[0] <= whole.seconds[0] and same.seconds[1] <= whole.seconds[1]
  assert confirmed.seconds[0] == same.seconds[0] and "confirmed by MuJoCo" in confirmed.note
  assert all(re.search(r"processor time \d+\.\d\d", measured.note) for measured in fits)
  assert whole.goal == same.goal == 10.0 and not whole.at_most


def test_benchmark_writes_a_row_for_every_pair(fits, tmp_path, capsys, monkeypatch):
  monkeypatch.setattr(benchmark, "fit_pairs", lambda *asked: {(2, 1.0, 0): fits}[asked])
  pairs = benchmark.main(benchmark.Config(tmp_path / "speed.md", quick=True))
  text = (tmp_path / "speed.md").read_text(encoding="utf-8")
  rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| what")]
  assert len(rows) == len(pairs) == 8 and all(f"| {pair.ratio:.2f} |" in text for pair in pairs)
  assert capsys.readouterr().out.count("(goal") == len(pairs)
  assert ("the library itself" in text) is any(pair.sides[0] == "mujoco.sysid" for pair in pairs)
  assert not list(tmp_path.glob(".writing-*"))
