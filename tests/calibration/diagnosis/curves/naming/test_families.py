"""Named maps are asked for simpler forms once everything has joined."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import families, refits
from calibration.diagnosis.curves.naming.families import made_simpler
from calibration.diagnosis.curves.naming.forms import Form, Outline

SIZES = {"bent": ("bent_a", "bent_b"), "dead": ("dead_a",), "other": ("other_a",)}


def form(*names, value=0.1):
  values = {p: value for name in names for p in SIZES[name]}
  return Form(names, values, values, 1.0, 1.0)


@dataclasses.dataclass
class Fake:
  """Trials whose models are candidates by the names of their forms; one of the bent form, one of a joined effect."""

  forms: tuple = ("bent", "lag")

  def __post_init__(self):
    free = [p for name in self.forms for p in SIZES.get(name, ("lag_a",))]
    self.base = self.freest = SimpleNamespace(free=free, values=np.full(len(free), 0.7), mechanisms=self.forms)
    mechanism = lambda name: SimpleNamespace(
      parameters=[SimpleNamespace(name=p) for p in SIZES.get(name, ("lag_a",))],
      outlined_by="drive_curve" if name in SIZES else "",
    )
    self.problem = SimpleNamespace(observations=None, mechanism=mechanism)
    self.started = []

  def model(self, forms, start, without):
    gone = {name for name in self.forms if set(SIZES.get(name, ())) & set(without)}
    self.started.append(dict(start))
    names = (*(n for n in self.forms if n not in gone), *forms)
    free = [p for name in names for p in SIZES.get(name, ("lag_a",))]
    return SimpleNamespace(free=free, values=np.full(len(free), 0.3), mechanisms=names)

  def left_out(self, chosen, names):
    assert not set(names) & set(chosen.mechanisms)
    return Fake(chosen.mechanisms)


@pytest.fixture
def judged(monkeypatch):
  """Sets how often chance makes as much as a model lacks, by the forms in it."""

  def judge(rule):
    monkeypatch.setattr(families, "fit_together", lambda problem, models: models)
    worse = lambda model: refits.Test(0.0 if rule(set(model.mechanisms)) else 9.0, 100.0, 1.1)
    for module in (families, refits):
      monkeypatch.setattr(module, "tested", lambda model, base, problem: worse(model))
    monkeypatch.setattr(refits, "clustered_std", lambda model, observations: np.full(len(model.free), 0.02))

  return judge


def outline(*forms):
  return Outline("drive_curve", ("height",), np.zeros(1), np.ones(1), 0.0, forms, asked=3)


REFUSED = dataclasses.replace(form("dead"), p_value=0.0)


def test_a_simpler_form_that_will_do_by_now_takes_the_place(judged):
  judged(lambda names: "dead" in names)
  trials, (drawn,) = made_simpler(
    Fake(), [outline(form("bent"), REFUSED, dataclasses.replace(form("other"), p_value=0.0))]
  )
  assert set(trials.forms) == {"lag", "dead"}
  assert drawn.named.mechanisms == ("dead",) and drawn.named.values == {"dead_a": 0.3}
  assert drawn.named.std == {"dead_a": 0.02} and "bent" not in [f.mechanisms[0] for f in drawn.forms]


def test_what_is_still_refused_changes_nothing(judged):
  judged(lambda names: False)
  before = outline(form("bent"), REFUSED)
  trials, (drawn,) = made_simpler(Fake(), [before])
  assert set(trials.forms) == {"lag", "bent"} and drawn is before


@pytest.mark.parametrize("drawn", [outline(form("dead"), form("bent")), outline(REFUSED), outline()])
def test_the_simplest_form_and_a_curve_without_a_name_are_not_asked(judged, drawn):
  judged(lambda names: pytest.fail("nothing was to be asked"))
  trials = Fake(("dead", "lag"))
  assert made_simpler(trials, [drawn]) == (trials, (drawn,))


def test_a_part_of_a_pair_starts_where_it_stands(judged):
  judged(lambda names: "bent" not in names)
  trials = Fake(("bent", "dead"))
  made_simpler(trials, [outline(form("bent", "dead"), REFUSED)])
  assert trials.started == [{"dead_a": 0.7}]


def test_forms_that_joined_a_map_without_a_departure_are_asked_too(judged):
  judged(lambda names: "dead" in names)
  level = dataclasses.replace(outline(form("bent"), form("dead")), departs=1.0)
  trials, (drawn,) = made_simpler(Fake(), [level])
  assert set(trials.forms) == {"lag", "dead"} and drawn is level
