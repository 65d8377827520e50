"""Curves are asked for their names by refits, and once more when others have joined."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import refits, substitution
from calibration.diagnosis.curves.naming.forms import Form, Outline
from calibration.diagnosis.curves.naming.substitution import named_again, substituted

SIZES = {"dead": ("dead_a",), "bent": ("bent_a", "bent_b")}
CURVE = "drive_curve"


@dataclasses.dataclass
class Fake:
  """Trials of one curve; models are the forms in its place and what has joined."""

  curves: tuple = (CURVE,)
  forms: tuple = ()

  def __post_init__(self):
    owned = lambda name: SIZES.get(name, ("height",))
    mechanism = lambda name: SimpleNamespace(parameters=[SimpleNamespace(name=p) for p in owned(name)])
    self.problem = SimpleNamespace(observations=None, mechanism=mechanism)
    self.base = self.freest = SimpleNamespace(mechanisms=self.forms)

  def model(self, forms, start, without):
    assert set(without) == {"height"}
    free = [p for name in forms for p in SIZES[name]]
    return SimpleNamespace(free=free, values=np.full(len(free), 0.3), mechanisms=(*self.forms, *forms))

  def going_on_from(self, chosen, without):
    return Fake(tuple(c for c in self.curves if c != without), chosen.mechanisms)


@pytest.fixture
def judged(monkeypatch):
  """Sets by how much a twin with some mechanisms errs more than the one with the curve; 1 is never refused."""

  def judge(error):
    test = lambda model: refits.Test(9.0, 100.0, error(set(model.mechanisms)))
    monkeypatch.setattr(substitution, "fit_together", lambda problem, models, plainest: models)
    for module in (substitution, refits):
      monkeypatch.setattr(module, "tested", lambda model, base, problem: test(model))
    monkeypatch.setattr(refits, "clustered_std", lambda model, observations: np.full(len(model.free), 0.02))

  return judge


def form(name):
  values = dict.fromkeys(SIZES[name], 0.1)
  return Form((name,), values, values, 1.0, 1.0)


def outline():
  return Outline(CURVE, ("height",), np.ones(1), np.ones(1), 0.0, (form("dead"), form("bent")))


def test_the_simplest_form_that_is_not_refused_takes_the_curves_place(judged):
  judged(lambda names: 1.0 if names & {"dead", "bent"} else 1.5)
  trials, (drawn,) = substituted(Fake(), [outline()])
  assert trials.curves == () and trials.forms == ("dead",)
  assert drawn.named.mechanisms == ("dead",) and drawn.named.values == {"dead_a": 0.3} and drawn.without == 1.5


def test_a_curve_that_every_form_is_refused_for_stays_and_is_told_nearly(judged):
  judged(lambda names: 1.04 if "bent" in names else 1.3 if "dead" in names else 1.5)
  trials, (drawn,) = substituted(Fake(), [outline()])
  assert trials.curves == (CURVE,) and drawn.is_there and drawn.named is None
  assert drawn.nearly.mechanisms == ("bent",) and drawn.left(drawn.nearly) == pytest.approx(0.08)


def test_where_nothing_at_all_does_as_well_nothing_departs(judged):
  judged(lambda names: 1.001)
  trials, (drawn,) = substituted(Fake(), [outline()])
  assert trials.curves == () == trials.forms and not drawn.is_there


def test_what_had_no_name_is_asked_once_more_beside_what_has_joined(judged):
  judged(lambda names: 1.0 if {"lag", "dead"} <= names else 1.5)
  before, drawn = substituted(Fake(), [outline()])
  assert before.curves == (CURVE,)
  trials, (again,) = named_again(Fake(forms=("lag",)), drawn)
  assert trials.curves == () and trials.forms == ("lag", "dead") and again.named.mechanisms == ("dead",)


def test_a_curve_that_has_gone_is_not_asked_again(judged):
  judged(lambda names: pytest.fail("nothing was to be asked"))
  gone, drawn = Fake(curves=(), forms=("dead",)), (outline(),)
  assert named_again(gone, drawn) == (gone, drawn)
