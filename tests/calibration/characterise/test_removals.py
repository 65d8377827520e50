"""What goes from beside the curves, and what stays."""

import dataclasses
from types import SimpleNamespace

import pytest

from calibration.characterise import refits, removals
from calibration.characterise.removals import matters, without_the_needless
from qcar_twin.parameters import Parameter, ParameterSet

SURE = 9.0  # t of what chance does not make


@dataclasses.dataclass
class Fake:
  """Trials whose models are the sets of parameters they do without."""

  beside: tuple
  lead: float = 0.0
  more: tuple = ()
  forms: tuple = ()

  def __post_init__(self):
    parameter = lambda name: Parameter(name, 0.0, -1.0, 1.0, "s", null=0.0)
    self.problem = SimpleNamespace(mechanism=lambda name: SimpleNamespace(parameters=(parameter(name),)))
    everything = (*self.beside, *self.forms, *self.more)
    self.base = SimpleNamespace(free=ParameterSet([parameter(n) for n in everything]))
    self.found = SimpleNamespace(lead=self.lead)

  def model(self, without):
    return frozenset(without)

  def left_out(self, chosen, names):
    assert chosen == frozenset(names)
    left = lambda among: tuple(n for n in among if n not in names)
    return Fake(left(self.beside), self.lead, self.more, left(self.forms))


@pytest.fixture
def asked(monkeypatch):
  """Sets how much a twin is worse without a set of mechanisms: t of the test, and the error."""

  def ask(rule):
    monkeypatch.setattr(removals, "fit_together", lambda problem, models: models)
    monkeypatch.setattr(removals, "tested", lambda model, base, problem: refits.Test(rule(model), 1.0, 1.1))

  return ask


def test_only_what_is_missed_stays(asked):
  asked(lambda without: SURE if "imu_latency" in without else 0.3)
  trials, tests = without_the_needless(Fake(("steering_lag", "imu_latency", "gyro_scale")))
  assert trials.beside == ("imu_latency",)
  assert [matters(tests, name) for name in ("steering_lag", "imu_latency", "gyro_scale")] == [False, True, False]


def test_a_form_that_does_nothing_once_others_have_joined_goes(asked):
  asked(lambda without: SURE if {"battery_sag", "imu_latency"} & without else 0.2)
  trials, _ = without_the_needless(Fake(("imu_latency",), forms=("steering_gain_error", "battery_sag")))
  assert (trials.beside, trials.forms) == (("imu_latency",), ("battery_sag",))


def test_of_two_that_stand_in_for_each_other_one_stays_and_matters(asked):
  asked(lambda without: SURE if {"steering_lag", "steering_delay"} <= without else 0.1 * len(without))
  trials, tests = without_the_needless(Fake(("steering_lag", "steering_delay")))
  assert len(trials.beside) == 1
  assert matters(tests, trials.beside[0])


def test_what_is_small_but_no_chance_stays_and_does_not_matter(asked, monkeypatch):
  asked(lambda without: SURE)
  monkeypatch.setattr(removals, "tested", lambda *_: refits.Test(SURE, 100.0, 1.001))
  trials, tests = without_the_needless(Fake(("wheel_radius_error",)))
  assert trials.beside == ("wheel_radius_error",) and not matters(tests, "wheel_radius_error")


def test_a_delay_that_holds_the_lead_of_commands_stays(asked):
  asked(lambda without: 0.0)
  trials, tests = without_the_needless(Fake(("steering_delay", "gyro_scale"), lead=0.1))
  assert trials.beside == ("steering_delay",) and not matters(tests, "steering_delay")


def test_what_sessions_have_shifts_of_is_not_asked(asked):
  asked(lambda without: 0.0)
  trials, tests = without_the_needless(Fake(("steering_offset", "gyro_scale"), more=("steering_offset@a",)))
  assert trials.beside == ("steering_offset",) and set(tests) == {"gyro_scale"}


def test_nothing_beside_the_curves_asks_nothing(asked):
  asked(lambda without: pytest.fail("nothing was to be asked"))
  assert without_the_needless(Fake(()))[1] == {}
