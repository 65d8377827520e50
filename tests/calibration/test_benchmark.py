"""Benchmarks: turns are taken fairly, and a pair says what it measured."""

import time

import pytest

from calibration.benchmark import Pair, control_period_against_steps, in_turn


def test_two_calls_take_turns_and_their_medians_come_back():
  order = []
  slow, quick = in_turn(lambda: (order.append("a"), time.sleep(0.004)), lambda: order.append("b"), 5)
  assert order == ["a", "b"] * 5
  assert slow > 0.003 > quick


def test_a_ratio_is_ours_over_theirs():
  assert Pair("x", 2.0, 4.0, 0.8).ratio == 0.5


def test_the_twin_costs_little_more_than_the_steps_it_contains():
  pair = control_period_against_steps(cars=64, rounds=7)
  assert pair.ratio == pytest.approx(1.1, abs=0.5)  # a loaded machine is no place for the aim itself
