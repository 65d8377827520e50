"""What goes from beside the curves, and what stays."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.curves.naming import refits, removals
from calibration.diagnosis.curves.naming.removals import matters, parameters_of, without_the_needless
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.mechanisms import catalogue

SURE = 9.0  # t of what chance does not make


@dataclasses.dataclass
class Fake:
  """Trials whose models are the sets of parameters they do without."""

  beside: tuple
  lead: float = 0.0
  more: tuple = ()
  forms: tuple = ()
  shifts: tuple = ()

  def __post_init__(self):
    parameter = lambda name: Parameter(name, 0.0, -1.0, 1.0, "s", null=0.0)
    self.problem = SimpleNamespace(mechanism=lambda name: SimpleNamespace(parameters=(parameter(name),)))
    everything = (*self.beside, *self.forms, *self.more)
    values = np.array([dict(zip(self.more, self.shifts, strict=False)).get(n, 0.5) for n in everything])
    self.base = SimpleNamespace(free=ParameterSet([parameter(n) for n in everything]), values=values)
    self.problem.observations = None
    self.found = SimpleNamespace(lead=self.lead)

  def model(self, without):
    return frozenset(without)

  def left_out(self, chosen, names):
    assert {n for n in chosen if "@" not in n} == set(names)
    left = lambda among: tuple(n for n in among if n not in names)
    return Fake(left(self.beside), self.lead, self.more, left(self.forms), self.shifts)


@pytest.fixture
def asked(monkeypatch):
  """Sets how much a twin is worse without a set of mechanisms: t of the test, and the error."""

  def ask(rule):
    monkeypatch.setattr(removals, "fit_together", lambda problem, models: models)
    monkeypatch.setattr(removals, "clustered_std", lambda model, observations, asked: np.full(len(asked), 0.1))
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


SESSIONS = ("steering_offset@a", "steering_offset@b")


def test_what_sessions_differ_in_is_not_asked(asked):
  """Without what they share their shifts would stand in for it."""
  asked(lambda without: 0.0)
  twin = Fake(("steering_offset", "gyro_scale"), more=SESSIONS, shifts=(0.7, -0.5))
  trials, tests = without_the_needless(twin)
  assert trials.beside == ("steering_offset",) and set(tests) == {"gyro_scale"}


@pytest.mark.parametrize("missed", [True, False])
def test_what_sessions_share_is_asked_without_shifts_that_are_chance(asked, missed):
  seen = []
  asked(lambda without: seen.append(without) or (SURE if missed and "steering_offset" in without else 0.0))
  trials, tests = without_the_needless(Fake(("steering_offset",), more=SESSIONS, shifts=(0.1, -0.1)))
  assert seen[0] == {"steering_offset", *SESSIONS}
  assert matters(tests, "steering_offset") is missed and bool(trials.beside) is missed


def test_nothing_beside_the_curves_asks_nothing(asked):
  asked(lambda without: pytest.fail("nothing was to be asked"))
  assert without_the_needless(Fake(()))[1] == {}


def test_what_is_left_out_takes_its_shifts_along_and_gives_back_what_was_measured():
  """A refit without a trim must not have it again as the trims of all sessions."""
  offset = catalogue()["steering_offset"].parameters[0]
  mass = Parameter("mass", 2.0, 1.0, 3.0, "kg", std=0.1)
  shifts = [dataclasses.replace(offset, name=name, std=0.02) for name in SESSIONS]
  free = ParameterSet([offset, mass, *shifts])

  def embed(names, values, around):
    full = np.array(around, float)
    full[[free.index(n) for n in names]] = values
    return full[None]

  problem = SimpleNamespace(
    mechanism=catalogue().__getitem__, parameters=free, observations=range(5), n_train=5, embed=embed
  )
  base = Candidate((), free, np.zeros(4), np.zeros(5), np.ones((5, 4)), np.array([0.03, 2.1, 0.0, 0.0]), 5)
  fitted = SimpleNamespace(fit=SimpleNamespace(parameters=free))
  found = SimpleNamespace(curves=(), beside=("steering_offset",), fitted=fitted, lead=0.0)
  trials = refits.Trials(problem, base, found, (), ("steering_offset",), "pose_latency", base)
  left = trials.model(without=parameters_of(trials, ["steering_offset"]))
  assert left.free.names == ("mass",) and left.values.tolist() == [2.1]
