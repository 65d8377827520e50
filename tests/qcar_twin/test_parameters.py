"""Parameters: declarations that can't contradict themselves, vectors that round-trip."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qcar_twin.parameters import Parameter, ParameterSet

MASS = Parameter("mass", 2.7, 1.0, 5.0, "kg", std=0.02)
FRICTION = Parameter("friction", 0.0, 0.0, 2.0, "N", null=0.0, typical=1.0)
OPEN = Parameter("open", 1.0, 0.0, 3.0, "-")
STIFFNESS = Parameter("stiffness", 500.0, 20.0, 5000.0, "N", factor=3.0)


def test_a_nominal_value_outside_its_bounds_is_refused_with_the_cure():
  with pytest.raises(ValueError, match="parameter 'mass': nominal 9 kg lies outside.*widen the bounds"):
    Parameter("mass", 9.0, 1.0, 5.0, "kg")


def test_a_null_outside_its_bounds_is_refused():
  with pytest.raises(ValueError, match="null -1 lies outside"):
    Parameter("drag", 0.5, 0.0, 1.0, "N", null=-1.0)


def test_a_name_declared_twice_is_refused():
  with pytest.raises(ValueError, match="'mass' is declared twice"):
    ParameterSet([MASS, MASS])


def test_an_unknown_name_gets_the_nearest_ones():
  with pytest.raises(KeyError, match="no parameter 'frition'; did you mean friction"):
    ParameterSet([MASS, FRICTION]).index("frition")


@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3))
def test_vector_and_names_round_trip(values: list[float]):
  parameters = ParameterSet([MASS, FRICTION, OPEN])
  assert parameters.vector(parameters.named(np.array(values))).tolist() == values


def test_prior_scale_and_concatenation():
  parameters = ParameterSet([MASS]) + [FRICTION, OPEN]
  assert parameters.std.tolist() == [0.02, 2.0 / 3.0, 1.0]  # a third of the range where nothing is stated
  assert parameters.scale.tolist() == [0.02, 1.0, 0.3]
  assert Parameter("order", 1.0, 0.2, 12.0, "-", step=0.05).scale == 0.05
  assert parameters.names == ("mass", "friction", "open")


def test_one_deviation_of_a_class_figure_is_its_factor():
  parameters = ParameterSet([MASS, STIFFNESS])
  assert parameters.deviations([2.74, 1500.0]).tolist() == pytest.approx([2.0, 1.0])
  assert parameters.deviations([2.7, 500.0 / 9.0]).tolist() == pytest.approx([0.0, -2.0])
  assert parameters.std[1] == pytest.approx(500.0 * np.log(3.0))


@given(st.floats(0.1, 10.0), st.floats(1.5, 4.0))
def test_slopes_of_deviations_are_their_differences(share: float, mass: float):
  parameters, step = ParameterSet([MASS, STIFFNESS]), 1e-6
  theta = np.array([mass, 500.0 * share])
  moved = [parameters.deviations(theta * (1.0 + s * step)) for s in (0.5, -0.5)]
  assert parameters.deviation_slopes(theta) == pytest.approx((moved[0] - moved[1]) / (step * theta), rel=1e-6)


def test_each_parameter_says_how_it_is_known():
  assert [p.kind for p in (MASS, OPEN, STIFFNESS)] == ["measured", "open", "class"]
  assert dataclasses.replace(MASS, assumed=True).kind == "class"
  assert "class, a factor of 3" in repr(ParameterSet([STIFFNESS]))


@pytest.mark.parametrize("wrong", [{"factor": 1.0}, {"lower": 0.0}, {"std": 3.0}])
def test_a_log_normal_prior_that_cannot_be_is_refused(wrong: dict[str, float]):
  with pytest.raises(ValueError, match="'stiffness': a log-normal prior needs a factor above 1"):
    dataclasses.replace(STIFFNESS, **wrong)


def test_a_vector_of_the_wrong_length_is_refused():
  with pytest.raises(ValueError, match="expected a vector of 2 parameters, got shape \\(3,\\)"):
    ParameterSet([MASS, FRICTION]).named(np.zeros(3))
