"""A formula as data: what is read, refused, held and spelt."""

import numpy as np
import pytest

from qcar_twin.twin.formula import Law, Table, Term
from qcar_twin.twin.formula.law import clip_to
from qcar_twin.twin.formula.table import hats
from qcar_twin.twin.formula.variables import VARIABLES, spell


def test_a_term_reads_back_as_it_is_written():
  for text in ("abs(yaw_rate) * sign(speed)", "speed * abs(accel_y)", "cos2(heading)", "square(steering)", "1"):
    assert str(Term.parse(text)) == text


@pytest.mark.parametrize(
  ("text", "said"),
  [
    ("__import__('os')", "no factor"),
    ("exp(speed)", "no operation 'exp'"),
    ("abs(yawrate)", "no variable 'yawrate'"),
    ("cos(speed)", "no meaning"),
    ("abs(heading)", "no meaning"),
    ("speed + yaw_rate", "no factor"),
  ],
)
def test_what_is_no_term_is_refused_with_what_there_is(text: str, said: str):
  with pytest.raises(ValueError, match=said):
    Term.parse(text)


def test_the_unit_of_a_coefficient():
  term = Term.parse("abs(yaw_rate) * sign(speed)")
  assert term.unit == {"rad": 1, "s": -1}
  assert spell({"N": 1, "rad": -1, "s": 1}) == "N s/rad"
  assert spell({"N": 1, "m": -2, "s": 3}) == "N s^3/m^2"
  assert spell({"N": 1, "u": -1}, "A") == "N/A"


def test_a_law_needs_a_range_of_every_variable_and_a_limit():
  with pytest.raises(ValueError, match="range of speed"):
    Law("force_x", ("abs(yaw_rate) * sign(speed)",), {"yaw_rate": (-1.0, 1.0)}, 1.0)
  with pytest.raises(ValueError, match="positive number"):
    Law("force_x", ("yaw_rate",), {"yaw_rate": (-1.0, 1.0)}, np.inf)
  with pytest.raises(ValueError, match="needs a term"):
    Law("force_x", (), {}, 1.0)


def test_beyond_its_range_a_variable_is_held():
  assert clip_to(np.array([-9.0, 0.5, 9.0]), (-1.0, 3.0)).tolist() == [-1.4, 0.5, 3.4]


def test_hats_add_up_to_one_and_an_angle_goes_round():
  knots, x = np.linspace(-np.pi, np.pi, 7), np.linspace(-9.0, 9.0, 50)
  assert np.allclose(hats(x, knots).sum(axis=-1), 1.0)
  turning = hats(x, knots, angular=True)
  assert np.allclose(turning.sum(axis=-1), 1.0)
  assert np.allclose(turning, hats(x + 2.0 * np.pi, knots, angular=True))


def test_a_table_of_an_angle_has_no_jump_where_a_turn_ends():
  """Whatever its heights: a car that turns through half a turn feels the same on either side."""
  table = Table("force_x", {"heading": tuple(np.linspace(-np.pi, np.pi, 7).tolist())}, 4.0)
  heights = np.random.default_rng(0).normal(size=len(table.terms))
  before, after = table.basis({"heading": np.array([np.pi - 1e-9, 1e-9 - np.pi])}, {}) @ heights
  assert before == pytest.approx(after, abs=1e-6)


def test_a_table_of_two_variables_is_exact_where_a_product_is_bilinear():
  table = Table("force_x", {"speed": (0.0, 1.0, 2.0), "yaw_rate": (-2.0, 0.0, 2.0)}, 4.0)
  at = np.array([[s * r for r in (-2.0, 0.0, 2.0)] for s in (0.0, 1.0, 2.0)]).reshape(-1)
  values = {"speed": np.array([0.3, 1.7]), "yaw_rate": np.array([-1.1, 0.4])}
  assert np.allclose(table.basis(values, {}) @ at, values["speed"] * values["yaw_rate"])
  with pytest.raises(ValueError, match="must rise"):
    Table("force_x", {"speed": (1.0, 0.0)}, 1.0)


def test_every_variable_has_a_name_a_term_can_hold():
  for name, variable in VARIABLES.items():
    assert Term.parse(f"cos({name})" if variable.angular else name).variables == {name}
