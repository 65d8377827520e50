"""Concealed formulas: none is drawn by a campaign, each acts where it says, and the command writes its page."""

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.concealed.benchmarks import formula
from calibration.concealed.benchmarks.formula import Case, cases_of, rates, read_case
from calibration.concealed.benchmarks.formula_page import chosen
from calibration.concealed.benchmarks.hidden_formulas import FORMULAS, SECOND, concealed, offered
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
  cars = cases_of(5, 2, 2, names, each=3)
  assert [(car, seed) for car, seed, _ in cars] == [("first", 5), ("second", 7), ("first", 6), ("second", 8)]
  assert cars[0][2] == ["", *names[:3]] and cars[2][2] == ["", *names[3:6]]
  assert all(set(turn) <= {"", *SECOND} and len(turn) == 4 for car, _, turn in cars if car == "second")
  assert [turn for *_, turn in cases_of(5, 1, 1, names)] == [["", *names], ["", *SECOND]]


PICTURE = {"x": "yaw rate [rad/s]", "y": "F_x [N]", "at": [0.0, 1.0], "recovered": [0.0, -1.1], "told": [0.0, -1.2],
           "true": None}  # fmt: skip


def case(name: str, kind: str, right: bool = False, change: float = 0.6) -> Case:
  """One that says something wherever something ships."""
  return Case("first", 1, name, kind, "Said.", bool(kind), "F_x = -1.2 |r|" if kind else "", "" if kind else "no.", "",
              change if kind else 1.0, 9.0, (0.05 if right else 0.4) if kind else None, right, right, True,
              PICTURE if kind else {})  # fmt: skip


def test_rates_are_of_what_they_say_with_exact_intervals():
  done = [case("", ""), case("rug", "formula", True), case("rug", "formula", True), case("rug", "")]
  found = {what: (often, interval) for what, often, interval in rates(done)}
  assert found["nothing concealed: something ships"] == ("0 of 1", "0 to 98 %")
  assert found["a formula concealed: the right place"] == ("2 of 3", "9 to 99 %")
  assert found["a formula concealed: a formula within 10 % over the driving"][0] == "2 of 3"
  assert found["of those that ship: held-out errors fall"][0] == "2 of 2"
  assert [c.falls_short for c in done] == ["", "", "", "nothing ships"]
  assert case("rug", "formula").falls_short == "the wrong place, the wrong variables"
  assert case("", "table").falls_short == "something ships where nothing is concealed"


def test_the_command_goes_on_where_it_stopped_and_pictures_right_and_wrong_ones(tmp_path, monkeypatch):
  """The cases are made up: what is done is kept, what fails costs no other car, and all that is there is scored."""
  asked, broken = [], {72}

  def answered(base, car, seed, name):
    if seed in broken:
      raise ValueError("no minimum")
    asked.append((seed, name))
    return dataclasses.replace(case(name, "formula" if name else "", seed == 71), seed=seed)

  monkeypatch.setattr(formula, "true_base", lambda seed, car: object())
  monkeypatch.setattr(formula, "case_of", answered)
  config = benchmark_formula.Config(tmp_path, tmp_path / "page.md", cars=3, formulas=("rug", "grain"), each=1)
  with pytest.raises(RuntimeError, match=r"first 72 \(ValueError: no minimum\)"):
    benchmark_formula.main(config)
  assert asked == [(71, ""), (71, "rug"), (73, ""), (73, "rug")] and (tmp_path / "first_72.error.txt").is_file()
  assert "4 of 6 cases are done" in (tmp_path / "page.md").read_text(encoding="utf-8")
  broken.clear()
  text = benchmark_formula.main(config)
  assert asked[4:] == [(72, ""), (72, "grain")] and not list(tmp_path.glob("*.error.txt"))
  assert "cases are done" not in text and text.count("F_x = -1.2") == 3 and (tmp_path / "page.png").is_file()
  assert "| nothing concealed: something ships | 0 of 3 |" in text
  assert [c.seed for c in chosen([c for c in map(read_case, sorted(tmp_path.glob("*.json")))])] == [71, 72, 73]
  assert benchmark_formula.main(dataclasses.replace(config, score_only=True)) == text and len(asked) == 6


@pytest.mark.slow
def test_the_command_drives_a_car_and_writes_its_page(tmp_path, monkeypatch):
  """A third of the session without a formula, made once; one with a formula takes several times as long."""

  @functools.cache
  def third(seed, name, car="first"):
    whole = concealed(seed, name, car=car)
    return dataclasses.replace(whole, recordings=whole.recordings[2::3])

  monkeypatch.setattr(formula, "concealed", third)
  config = benchmark_formula.Config(tmp_path, tmp_path / "page.md", quick=True)
  text = benchmark_formula.main(dataclasses.replace(config, formulas=()))
  kept = read_case(tmp_path / "first_71_nothing.json")
  assert text == (tmp_path / "page.md").read_text(encoding="utf-8") and text.count("| first 71 |") == 1
  assert not kept.ships and kept.finite and 0.0 < kept.seconds < 300.0 and kept.why in text
