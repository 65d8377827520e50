"""Concealed formulas: none is drawn by a campaign, each acts where it says, and the command writes its page."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.concealed.benchmarks.formula import Case, case_of, cases_of, rates
from calibration.concealed.benchmarks.hidden_formulas import FORMULAS, SECOND, offered
from calibration.concealed.proving_ground import EFFECTS
from qcar_twin.twin.formula.degrees import BODY, DEGREES
from qcar_twin.twin.formula.variables import VARIABLES
from scripts import benchmark_formula


def test_they_are_the_generators_only_while_a_session_is_made():
  assert not set(FORMULAS) & set(EFFECTS)
  with offered():
    assert set(FORMULAS) <= set(EFFECTS)
  assert not set(FORMULAS) & set(EFFECTS)


@pytest.mark.parametrize("name", FORMULAS)
def test_a_formula_is_a_function_of_what_it_says(name: str):
  kind, random = FORMULAS[name], np.random.default_rng(0)
  assert kind.degree in DEGREES and kind.depends_on <= set(VARIABLES) and kind.written
  values = {v: random.uniform(0.2, 1.5, 40) for v in VARIABLES}
  before = kind.value_of(values)
  other = {v: x if v in kind.depends_on or v in ("speed", "yaw_rate") else 0.0 * x for v, x in values.items()}
  assert np.isfinite(before).all() and np.array_equal(kind.value_of(other), before)
  assert np.ptp(before) > 0.0


@pytest.mark.parametrize("name", SECOND)
def test_in_the_second_car_it_acts_where_it_says_and_nowhere_else(name: str):
  kind, random = FORMULAS[name], np.random.default_rng(0)
  state = SimpleNamespace(**{n: random.uniform(0.2, 1.5, 3) for n in ("u", "r", "x", "y", "yaw")})
  push = kind.push(SimpleNamespace(state=state, n=3))  # type: ignore[arg-type]
  channels = {n: np.ones((5, 3)) for n in ("accel_x", "accel_y", "yaw_rate", "motor_speed")}
  kind.misread(channels)
  bent = [n for n, values in channels.items() if not (values == 1.0).all()]
  if kind.degree in BODY:
    row = BODY.index(kind.degree)
    assert not bent and (push[row] != 0.0).all() and not np.delete(push, row, axis=0).any()
  else:
    assert bent == [DEGREES[kind.degree].signal] and not push.any()


def test_cars_take_turns_with_the_formulas():
  names = list(FORMULAS)
  cars = list(cases_of(5, 2, 2, names, each=3))
  assert [(car, seed) for car, seed, _ in cars] == [("first", 5), ("first", 6), ("second", 7), ("second", 8)]
  assert cars[0][2] == names[:3] and cars[1][2] == names[3:6]
  assert all(set(turn) <= set(SECOND) and len(turn) == 3 for car, _, turn in cars if car == "second")
  assert [turn for *_, turn in cases_of(5, 1, 1, names)] == [names, list(SECOND)]


def test_rates_are_of_what_they_say_with_exact_intervals():
  bare = SimpleNamespace(kept=False, rest=SimpleNamespace(sought=None, kind="", twin=None), change=1.0)
  ships = SimpleNamespace(kept=True, rest=SimpleNamespace(sought=object(), kind="formula", twin=None), change=0.6)
  case = lambda name, shipped, right: Case("first", 1, name, shipped, 9.0, 0.05 if right else 0.4, right, right, True)
  done = [case("", bare, False), *(case("rug", ships, True) for _ in range(2)), case("rug", bare, False)]
  found = {what: (often, interval) for what, often, interval in rates(done)}
  assert found["nothing concealed: something ships"] == ("0 of 1", "0 to 98 %")
  assert found["a formula concealed: the right place"] == ("2 of 3", "9 to 99 %")
  assert found["a formula concealed: a formula within 10 % over the driving"][0] == "2 of 3"
  assert found["of those that ship: held-out errors fall"][0] == "2 of 2"
  assert [c.falls_short for c in done] == ["", "", "", "nothing ships"]
  assert case("rug", ships, False).falls_short == "the wrong place, the wrong variables"


@pytest.mark.slow
def test_the_command_writes_its_page(tmp_path, monkeypatch):
  """The session without a formula is driven; it stands in for the one with a formula, which takes minutes."""
  asked, driven = [], []

  def answered(base, kind, seed, name):
    asked.append(name)
    driven.append(dataclasses.replace(driven[0], name=name) if driven else case_of(base, kind, seed, name))
    return driven[-1]

  monkeypatch.setattr(benchmark_formula, "case_of", answered)
  text = benchmark_formula.main(benchmark_formula.Config(tmp_path / "page.md", quick=True))
  assert asked == ["", next(iter(FORMULAS))]
  assert text == (tmp_path / "page.md").read_text(encoding="utf-8")
  assert text.count("| first 71 |") == 2 and "`qcar-twin benchmark-formula --seed 71" in text
