"""What the online filter gets through: honest where it calls itself valid, and no sound sensor accused."""

import dataclasses

import numpy as np
import pytest

from agents.studies.fault_study import BEGIN
from agents.studies.filtering.acceptance_study import (
  CASES,
  LIMIT,
  WEAVE_SECONDS,
  Case,
  Driven,
  judge,
  limit_drive,
  lock_drive,
  weave_drive,
)
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings
from qcar_twin.sensors.faults import Fault
from scripts.benchmark_filter import subject

SOUND = Case()
OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("first", "second")]


@pytest.fixture(scope="module")
def weave():
  driven = {}

  def of(name):
    if name not in driven:
      one = subject(name, 3)
      driven[name] = one, weave_drive(one)
    return driven[name]

  return of


@pytest.mark.parametrize("name", ["twin", *OTHERS])
def test_at_the_limit_of_grip_the_model_is_doubted_and_no_sensor(name):
  """Understeer and spins at up to 4 m/s, forward and in reverse: yaw within 4 degrees, position within 15 cm."""
  car = subject(name, 3)
  driven = limit_drive(car)
  lateral = np.abs(driven.signals[..., 3] * driven.signals[..., 5])
  assert np.all(lateral[300:].max(axis=0) > 5.0)  # m/s^2: they are at the limit
  outcome = judge(car, driven, SOUND)
  for forward in (True, False):
    some = outcome.of((LIMIT[:, 0] > 0.0) == forward)
    assert some.falsely(SOUND) == 0, some.accused
    assert some.beyond <= 0.05 and some.valid.mean() > 0.97
    assert np.abs(some.yaw[some.valid]).max() < 0.07 and np.nanmax(some.position) < 0.15
    assert np.nanmedian(some.nees) < 6.0  # the fusion takes the yaw that turns its acceleration as known


@pytest.mark.parametrize("name", ["twin", *OTHERS])
def test_at_full_lock_a_filter_with_the_linkage_as_a_state_is_honest(name):
  """Where wheels turn by 0.5 rad no linear single track holds; the plain filter is beyond its bounds there."""
  car = subject(name, 3)
  outcome = judge(dataclasses.replace(car, settings=car.settings.estimating(*ESTIMATED)), lock_drive(car), SOUND)
  assert outcome.falsely(SOUND) == 0 and outcome.beyond <= 0.05
  assert outcome.valid.mean() > 0.97 and np.nanmax(outcome.position) < 0.07


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ["twin", *OTHERS])
def test_valid_is_honest_and_nobody_is_accused_who_is_sound(weave, name, case):
  """Clocks that jump, silence, every class of faults: at most one valid period in twenty is beyond its bounds."""
  car, driven = weave(name)
  outcome = judge(car, driven, CASES[case])
  assert outcome.falsely(CASES[case]) == 0, outcome.accused
  assert outcome.beyond <= 0.05
  unheard = max(0.0, CASES[case].silence - FilterSettings().buffer)  # s, in which it may well say that it is blind
  assert outcome.valid.mean() > 0.95 - unheard / WEAVE_SECONDS
  assert outcome.valid[-1].all() and outcome.position[-1].max() < 0.06


@pytest.mark.parametrize("case", ["silence of 2 s", "silence of 7 s"])
def test_after_a_silence_the_first_fix_is_taken(weave, case):
  """A car nobody has heard from may have been steered anywhere: it is not valid before, and within bounds after."""
  car, driven = weave("twin")
  outcome = judge(car, driven, CASES[case])
  heard = round((BEGIN + CASES[case].silence) / car.settings.period)
  assert not outcome.valid[heard - 1].any() and outcome.valid[heard + 10].all()
  assert outcome.beyond == 0.0 and np.nanmax(outcome.position) < 0.15


@pytest.mark.parametrize(
  ("fault", "word"),
  [
    (Fault("yaw_rate", "offset", 6.0, size=3.0), "gyro"),
    (Fault("yaw_rate", "offset", 6.0, size=-0.4), "gyro"),
    (Fault("yaw_rate", "frozen", 6.0, 11.0), "gyro"),
    (Fault("motor_speed", "stuck", 6.0), "encoder"),
  ],
)
def test_what_is_wrong_is_accused(weave, fault, word):
  """The witnesses that clear a sound gyro convict a wrong one, within the bounds that are stated."""
  car, driven = weave("twin")
  outcome = judge(car, driven, Case((fault,), accused=(word,)))
  assert all(word in words for words in outcome.accused) and outcome.falsely(Case(accused=(word,))) == 0
  assert outcome.beyond <= 0.05 and outcome.position[-1].max() < 0.06


def test_a_gyro_that_is_silent_is_not_judged(weave):
  """At the limit, without a gyro: what the model says of the yaw is no witness against it."""
  car = subject("twin", 3)
  driven = limit_drive(car)
  some = Driven(driven.signals[:, :2], driven.commands[:, :2])
  outcome = judge(car, some, Case((Fault("yaw_rate", "lost", 0.0),)))
  assert outcome.falsely(SOUND) == 0
