"""What is said of a formula, what the report shows, and what is written."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.formula.after import TWIN, Shipped, write_formula
from calibration.diagnosis.formula.dictionary import Group
from calibration.diagnosis.formula.finding import Found
from calibration.diagnosis.formula.forms import Form, Forms
from calibration.diagnosis.formula.looking import Sought
from calibration.diagnosis.formula.recovery import Recovered
from calibration.diagnosis.formula.refit import Refitted
from calibration.diagnosis.formula.report import formula_sections, said_by
from calibration.diagnosis.formula.tables import TableFit
from calibration.diagnosis.formula.words import alike_words, equation, sentence, variables
from calibration.diagnosis.holdout_errors import ChannelFit
from qcar_twin.pages import write_page
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.formula import Term
from tests.calibration.diagnosis.formula.test_formula import LinearCar, drag, driving
from tests.qcar_twin.twin.formula.formulas import twin_with, yaw_drag


@dataclasses.dataclass
class Model:
  """A fitted model of one number."""

  theta: np.ndarray


class Stated(Refitted):
  """With its number as it is."""

  @property
  def values(self):
    return [(p, -1.19, 0.06) for p in self.mechanism.parameters]


@dataclasses.dataclass
class Driven:
  twin: object


def found_of(kind: str = "formula", why: str = "") -> Found:
  """A drag by the yaw rate, found on the linear car."""
  driven = driving()
  car = LinearCar(drag(driven), driven)
  group = Group((Term.parse("abs(yaw_rate) * sign(speed)"),))
  form = Form("force_x", (group,), np.array([-1.2]), np.array([0.05]), 200.0)
  rival = dataclasses.replace(form, groups=(Group((Term.parse("speed * abs(steering)"),)),))
  forms = Forms(form, (form, rival), (), 0.9, 0.003, TableFit(("yaw_rate",), 190.0, 100.0, 0.003), 700.0)
  force = Recovered("force_x", 110.0, 1.0, 0.01, car.force / car.scale, np.full(car.force.shape, 0.001))
  twin, theta = twin_with(yaw_drag(), unnamed_force_x_1=-1.19)
  gain = Comparison(100.0, 5.0, 0.8, np.full(10, 10.0), 900.0)
  refit = Stated(yaw_drag(), Driven(twin), Model(theta), Model(theta), gain, gain)  # type: ignore[arg-type]
  sought = Sought(force, car.responses(), driven, forms)
  return Found(sought, ("motor_torque",), kind, why, refit, 12.0)


def errors(after: float) -> dict[str, ChannelFit]:
  return {"motor_speed": ChannelFit(10.0, after, 0.1, 0.1, (-0.7, -0.5), "rad/s", 500)}


def test_the_sentence_says_where_what_and_how_much():
  said = sentence(found_of(), 0.39)
  assert "A force along the car that follows yaw rate, F_x = (-1.19 ± 0.06 N s/rad) |r| sgn(v), takes 61 %" in said
  assert "can't tell it from a torque of the motor, or a function of speed and road-wheel angle" in said


def test_where_nothing_ships_it_says_why():
  nothing = Found(None, (), "", "what is left follows nothing that a formula was tried with", None, 3.0)
  assert sentence(nothing) == "No formula was found: what is left follows nothing that a formula was tried with."
  assert equation(nothing) == "" and alike_words(nothing) == "" and variables(nothing) == []
  assert "but in the simulator it does not" in sentence(found_of("", "in the simulator it does not predict better"))


def test_the_section_holds_numbers_errors_and_the_picture(tmp_path):
  (section,) = formula_sections(Shipped(found_of(), errors(3.9)))
  assert "unnamed_force_x.py" in section.text and TWIN in section.text
  assert [len(table.rows) for table in section.tables] == [1, 1] and len(section.figures) == 1
  page = write_page(tmp_path / "page.html", "title", "verdict", [section])
  assert "recovered from what the twin leaves over" in page.read_text(encoding="utf-8")
  assert formula_sections(None) == []


def test_the_picture_shows_the_formula_as_it_was_refitted():
  found = found_of()
  driven = found.sought.driven
  expected = -1.19 * np.abs(driven.values["yaw_rate"]) * np.tanh(driven.values["speed"] / driven.widths()["speed"])
  limit = yaw_drag().law.limit
  inside = np.abs(expected) < 0.9 * limit
  near = np.abs(driven.values["yaw_rate"]) < 2.0
  assert np.allclose(said_by(found)[inside & near], expected[inside & near])
  assert np.abs(said_by(found)).max() <= limit


@pytest.mark.parametrize(("after", "files"), [(3.9, 2), (10.5, 0)])
def test_what_held_out_recordings_speak_against_is_not_written(after: float, files: int, tmp_path):
  shipped = Shipped(found_of(), errors(after))
  assert len(write_formula(shipped, tmp_path, "a log")) == files
  assert len(list(tmp_path.iterdir())) == files
  (section,) = formula_sections(shipped)
  assert ("Nothing is written" in section.text) == (files == 0)
  if files:
    twin, theta = load_twin(tmp_path / TWIN, threads=1)
    assert theta[twin.parameters.index("unnamed_force_x_1")] == -1.19
  (tmp_path / TWIN).touch()
  assert write_formula(None, tmp_path, "another log") == [] and not (tmp_path / TWIN).exists()


def test_without_held_out_recordings_nothing_is_said_of_their_errors():
  (section,) = formula_sections(Shipped(found_of(), {}))
  assert "%" not in section.text and "no held-out recordings" in section.text
  (worse,) = formula_sections(Shipped(found_of(), errors(10.5)))
  assert "adds 5 % to the held-out errors" in worse.text and "off the held-out" not in worse.text
