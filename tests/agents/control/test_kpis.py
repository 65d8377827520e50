"""Indicators as properties: of drives made up from numbers, so that every answer is known."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.closed_loop import Drive
from agents.control.kpis import Kpis, kpis
from qcar_twin.paths import path_from_pieces, path_named
from qcar_twin.plant import SIGNALS

LINE = path_from_pieces("line", [(3.0, 0.0, 0.0)])
NUMBERS = st.floats(-0.2, 0.2, allow_nan=False)


def made_up(error, steering, path=LINE, finished=True, under_way=None):
  """A drive of one car with these cross-track errors, m, and steering commands, rad, (T,)."""
  error, steering = np.asarray(error, dtype=float), np.asarray(steering, dtype=float)
  count = len(error)
  signals = np.zeros((count, 1, len(SIGNALS)))
  commands = np.stack([np.zeros(count), steering], axis=-1)[:, None]
  alive = np.ones(count, dtype=bool) if under_way is None else np.asarray(under_way)
  column = np.zeros((count, 1))
  return Drive(
    path,
    0.01,
    signals,
    commands,
    np.zeros((count, 1, 3)),
    np.zeros((count, 1, 2)),
    column,
    column > -1.0,
    error[:, None],
    column,
    alive[:, None],
    np.array([finished]),
  )


@settings(max_examples=40, deadline=None)
@given(st.lists(NUMBERS, min_size=2, max_size=30))
def test_root_mean_square_lies_between_mean_and_maximum(errors):
  indicators = kpis(made_up(errors, np.zeros(len(errors))))
  assert np.mean(np.abs(errors)) <= indicators.rmse[0] + 1e-12 and indicators.rmse[0] <= indicators.me[0] + 1e-12


@settings(max_examples=40, deadline=None)
@given(st.lists(NUMBERS, min_size=2, max_size=30), st.floats(0.1, 5.0))
def test_indicators_grow_with_what_they_measure(errors, factor):
  errors = np.array(errors)
  plain, larger = kpis(made_up(errors, errors)), kpis(made_up(factor * errors, factor * errors))
  for name in ("rmse", "me", "iaca", "steering_rate"):
    np.testing.assert_allclose(getattr(larger, name), factor * getattr(plain, name), rtol=1e-9, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(NUMBERS, min_size=2, max_size=30))
def test_left_and_right_are_the_same_to_them(errors):
  errors = np.array(errors)
  plain, mirrored = kpis(made_up(errors, errors)), kpis(made_up(-errors, -errors))
  for field in dataclasses.fields(Kpis):
    np.testing.assert_allclose(getattr(mirrored, field.name), getattr(plain, field.name))


@settings(max_examples=30, deadline=None)
@given(st.lists(NUMBERS, min_size=4, max_size=20), st.integers(1, 3))
def test_what_comes_after_the_end_does_not_count(errors, left):
  alive = np.arange(len(errors)) < len(errors) - left
  whole = kpis(made_up(errors[:-left], errors[:-left]))
  longer = kpis(made_up(errors, errors, under_way=alive))
  for name in ("rmse", "me", "iaca"):
    np.testing.assert_allclose(getattr(longer, name), getattr(whole, name))


def test_steering_rate_of_a_ramp_is_its_slope():
  ramp = 0.4 * 0.01 * np.arange(2001)
  indicators = kpis(made_up(np.zeros(2001), ramp))
  assert indicators.steering_rate[0] == pytest.approx(0.4, rel=1e-3)


def test_a_lost_run_has_no_finite_error_but_an_effort():
  indicators = kpis(made_up([0.01, 0.02], [0.1, 0.1], finished=False))
  assert np.isinf(indicators.rmse[0]) and np.isinf(indicators.me[0]) and indicators.iaca[0] == pytest.approx(0.1)
  assert not indicators.finished[0] and not indicators.inside[0]


def test_borders_count_only_while_under_way():
  path = path_named("c")
  lane = path.lanes[0]
  drive = made_up([0.0, 0.0], [0.0, 0.0], path)
  middle = 0.5 * (lane.left + lane.right)
  inside, outside = (0.5 * (lane.start + lane.end), middle), (0.5 * (lane.start + lane.end), middle + 0.1)
  signals = drive.signals.copy()
  signals[0, 0, :2], signals[1, 0, :2] = inside, outside
  touched = dataclasses.replace(drive, signals=signals)
  assert not kpis(touched).inside[0]
  over = dataclasses.replace(touched, under_way=np.array([[True], [False]]))
  assert kpis(over).inside[0]
