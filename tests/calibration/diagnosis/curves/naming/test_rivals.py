"""What is asked in place of what is named, and which of two stays."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.curves.naming import refits, rivals
from calibration.diagnosis.curves.naming.forms import Form, Outline
from calibration.diagnosis.curves.naming.rivals import Rival, renamed, with_rivals
from qcar_twin.parameters import Parameter, ParameterSet

SURE, COUNT = 9.0, 200


def size(name):
  return Parameter(name, 0.0, -5.0, 5.0, "-", std=100.0, null=0.0, typical=1.0)


def effect(name, outlined_by=""):
  return SimpleNamespace(
    name=name, parameters=(size(name),), signed=True, stage="command", subsystem="all", outlined_by=outlined_by,
    initial_guesses=lambda driving: [{}],
  )  # fmt: skip


# directions of residuals: a drag, a lock that is nearly the same, and a sag that has nothing to do with either
RNG = np.random.default_rng(7)
DRAG, ODD, SAG = np.linalg.qr(RNG.normal(size=(COUNT, 3)))[0].T * 10.0
SHAPES = {"drag": DRAG, "lock": 0.9 * DRAG + 0.4 * ODD, "sag": SAG}


class Linear:
  """Residuals that are linear in three sizes; the truth is a lock and a sag of size 1."""

  parameters = ParameterSet(size(name) for name in SHAPES)
  driving = None

  def mechanism(self, name):
    return effect(name)

  def fitted_residual(self, thetas):
    return (thetas - np.array([0.0, 1.0, 1.0])) @ np.array([*SHAPES.values()])

  def fitted(self, names):
    """The least-squares model with some of the effects."""
    columns = np.array([SHAPES[n] for n in names]).T.reshape(COUNT, len(names))
    wanted = SHAPES["lock"] + SHAPES["sag"]
    values = np.linalg.lstsq(columns, wanted, rcond=None)[0] if names else np.zeros(0)
    theta = np.zeros(3)
    theta[[list(SHAPES).index(n) for n in names]] = values
    free = ParameterSet(size(n) for n in names)
    return Candidate(tuple(names), free, theta, self.fitted_residual(theta[None])[0], columns, values, COUNT)


@dataclasses.dataclass
class Fake:
  """Trials on the linear problem."""

  forms: tuple
  beside: tuple = ()

  def __post_init__(self):
    self.problem = Linear()
    self.base = self.problem.fitted(self.forms)

  def model(self, forms=(), start=None, without=()):
    return self.problem.fitted([*(n for n in self.forms if n not in without), *forms])

  def left_out(self, chosen, names):
    assert not set(names) & set(chosen.mechanisms)
    return Fake(chosen.mechanisms)


@pytest.fixture
def asked(monkeypatch):
  """Twins are judged by their costs, and effects outside are all that are not in."""
  test = lambda simpler, richer, problem: refits.Test(
    SURE * np.sign(round(simpler.cost - richer.cost, 6)), simpler.cost - richer.cost, 1.1
  )
  without = lambda trials, names: {name: trials.model(without={name}) for name in names}
  monkeypatch.setattr(rivals, "fit_together", lambda problem, models: models)
  monkeypatch.setattr(rivals, "without_each", without)
  for module in (rivals, refits):
    monkeypatch.setattr(module, "tested", test)
  monkeypatch.setattr(rivals, "asked_of", lambda trials: list(trials.forms))
  monkeypatch.setattr(rivals, "parameters_of", lambda trials, names: set(names))
  monkeypatch.setattr(rivals, "open_questions", lambda trials: [effect(n) for n in SHAPES if n not in trials.forms])


def found(trials, asked=()):
  return rivals.rivals(trials, {name: trials.model(without={name}) for name in trials.forms}, asked)


def test_what_stands_in_for_another_is_exchanged_and_what_is_missing_beside_it_is_not(asked):
  assert [(r.mechanism, r.instead_of) for r in found(Fake(("drag",)))] == [("lock", "drag")]
  trials, exchanged, tests = with_rivals(Fake(("drag",)))
  assert trials.forms == ("lock",) and exchanged == (("drag", "lock"),)
  assert set(tests) == {"lock"} and tests["lock"].t == SURE


def test_what_is_right_stays(asked):
  trials, exchanged, _ = with_rivals(Fake(("lock", "sag")))
  assert trials.forms == ("lock", "sag") and exchanged == ()


def test_a_rival_starts_near_the_size_that_takes_the_others_place(asked):
  (one,) = found(Fake(("drag", "sag")))
  assert one.start["lock"] == pytest.approx(1.0, abs=0.05) and one.share > 0.8


def test_what_was_exchanged_is_not_asked_again(asked):
  assert found(Fake(("drag",)), {"lock"}) == [] == found(Fake(("drag",)), {"drag"})


@pytest.mark.parametrize(
  "more, t, nats, taken",
  [
    (-1, 0.5, 2.0, True),  # simpler, and what it lacks may be chance
    (-1, SURE, 90.0, False),
    (0, 0.1, 1.0, True),  # as simple, and nearer
    (0, -0.1, -1.0, False),
    (1, 0.5, 2.0, False),  # less simple, and what it gains may be chance
    (1, SURE, 90.0, True),
  ],
)
def test_the_simpler_stays_unless_it_is_refused(monkeypatch, more, t, nats, taken):
  model = lambda count: SimpleNamespace(free=[None] * count, mechanisms=("new",))
  trials = SimpleNamespace(
    base=model(3),
    freest=model(3),
    problem=None,
    left_out=lambda chosen, names: "exchanged",
    model=lambda *given: model(3 + more),
  )
  monkeypatch.setattr(rivals, "rivals", lambda trials, missed, asked: [Rival("new", "old", {}, 1.0)])
  monkeypatch.setattr(rivals, "asked_of", lambda trials: [])
  monkeypatch.setattr(rivals, "without_each", lambda trials, names: {})
  monkeypatch.setattr(rivals, "parameters_of", lambda trials, names: set())
  monkeypatch.setattr(rivals, "fit_together", lambda problem, models: models)
  for module in (rivals, refits):
    monkeypatch.setattr(module, "tested", lambda simpler, richer, problem: refits.Test(t, nats, 1.1))
  monkeypatch.setattr(rivals, "_ROUNDS", 1)
  assert (with_rivals(trials)[0] == "exchanged") is taken


def test_a_form_gets_the_name_of_what_took_its_place(monkeypatch):
  monkeypatch.setattr(refits, "clustered_std", lambda model, observations: np.full(len(model.free), 0.25))
  curve = lambda name: effect(name, "" if name == "sag" else "steering_curve")
  trials = Fake(("lock", "sag"))
  trials.problem.mechanism, trials.problem.observations = curve, None
  forms = tuple(Form((name,), {name: 1.0}, {name: 0.1}, 1.0, 0.5) for name in ("drag", "lock"))
  drawn = Outline("steering_curve", (), np.zeros(0), np.zeros(0), 0.0, forms)
  made = renamed(drawn, [("drag", "lock")], trials)
  assert made.named.mechanisms == ("lock",) and made.named.std == {"lock": 0.25}
  assert made.named.values["lock"] == pytest.approx(1.0)
  assert [f.mechanisms for f in made.forms] == [("lock",)]
  assert renamed(drawn, [("drag", "sag")], trials) is drawn  # no form of this curve
  assert renamed(drawn, [], trials) is drawn
