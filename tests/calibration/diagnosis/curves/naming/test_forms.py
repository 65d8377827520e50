"""Curves get the name of the form they were made of, and none where they have none."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.flexible import Characterised
from calibration.diagnosis.curves.naming.forms import (
  LEVEL,
  Form,
  Outline,
  answer,
  left_with,
  outlines,
  projection,
  questions,
  situation,
)
from qcar_twin.plant import START, Segments
from qcar_twin.twin.mechanisms import curves, select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
CURVES = tuple(m.name for m in curves("voltage"))
REACH = {"drive_curve_reach": 3.0, "resistance_curve_reach": 2.5, "steering_curve_reach": CAR.max_steering}
NOISE = 0.004  # of a height


def characterised(heights: dict[str, np.ndarray]) -> Characterised:
  """A fitted twin whose curves have these heights, each known to NOISE; the driving covers lock, supply and speed."""
  twin = Twin(CAR, select(CURVES), substeps=2, engine="reduced")
  values = dict(REACH)
  for name, value in heights.items():
    values |= dict(zip([p.name for p in select([name])[0].parameters if p.null is not None], value, strict=True))
  theta = twin.parameters.vector(twin.parameters.named(twin.parameters.nominal) | values)
  commands = np.zeros((1, 200, 2))
  commands[0, :, 0] = np.linspace(0.0, 3.0, 200)
  commands[0, :, 1] = np.linspace(-CAR.max_steering, CAR.max_steering, 200)
  start = np.zeros((1, len(START)))
  start[0, START.index("velocity_x")] = 2.5
  segments = Segments(commands, start, np.array([200]), 0.01, ("a",), np.zeros(1))
  problem = SimpleNamespace(
    twin=twin,
    mechanism=lambda name: next(m for m in twin.mechanisms if m.name == name),
    observations=SimpleNamespace(stretches=SimpleNamespace(segments=segments)),
  )
  problem.exact = problem
  fit = SimpleNamespace(parameters=twin.parameters, theta=theta)
  found = Characterised(SimpleNamespace(problem=problem, fit=fit, theta=theta), CURVES, ("steering_offset",))
  object.__setattr__(found, "fitted", SimpleNamespace(problem=problem, fit=fit, theta=theta))
  return found


@pytest.fixture(autouse=True)
def known_covariance(monkeypatch):
  size = lambda found: len(found.fitted.fit.parameters)
  monkeypatch.setattr(Characterised, "covariance", property(lambda found: NOISE**2 * np.eye(size(found))))


def heights_of(curve: str, forms: dict[str, dict[str, float]], rng=None) -> np.ndarray:
  """Heights of a curve that is made of named forms, with noise."""
  blank = characterised({})
  item = blank.fitted.problem.mechanism(curve)
  project, _ = projection(blank, item)
  mechanisms = select(forms)
  theta = [forms[m.name].get(p.name, p.nominal) for m in mechanisms for p in m.parameters]
  found = project(mechanisms, np.array(theta))
  return found if rng is None else found + NOISE * rng.standard_normal(len(found))


MADE = {
  "steering_saturation": ("steering_curve", {"steering_saturation": 1.5}),
  "steering_asymmetry": ("steering_curve", {"steering_asymmetry": 0.15}),
  "drive_chopped": ("drive_curve", {"drive_chopped": 0.8, "drive_chopped_supply": 6.0}),
  "quadratic_drag": ("resistance_curve", {"quadratic_drag": 0.8}),
}


@pytest.mark.parametrize("form", MADE)
def test_a_form_gives_the_curve_its_name(form: str):
  curve, values = MADE[form]
  rng = np.random.default_rng(5)
  found = {o.curve: o for o in outlines(characterised({curve: heights_of(curve, {form: values}, rng)}))}
  assert [name for name, o in found.items() if o.is_there] == [curve]
  right = next(f for f in found[curve].possible if f.mechanisms == (form,))
  for name, value in values.items():
    assert right.values[name] == pytest.approx(value, abs=4.0 * right.std[name] + 1e-9)
  assert len(found[curve].named.values) <= len(right.values)


def test_right_forms_are_refused_as_often_as_stated():
  rng, curve, form = np.random.default_rng(6), "steering_curve", "steering_asymmetry"
  exact, tries = heights_of(curve, {form: {"steering_asymmetry": 0.2}}), 30
  refused = 0
  for _ in range(tries):
    noisy = exact + NOISE * rng.standard_normal(len(exact))
    (outline,) = [o for o in outlines(characterised({curve: noisy})) if o.curve == curve]
    fitted = next(f for f in outline.forms if f.mechanisms == (form,))
    refused += fitted.p_value < LEVEL
  assert refused <= 4  # binomial, 30 at 0.02: more than 4 in one of 3000


def test_a_zigzag_has_no_known_form():
  zigzag = 0.15 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
  found = {o.curve: o for o in outlines(characterised({"steering_curve": zigzag}))}
  assert found["steering_curve"].is_there and found["steering_curve"].named is None


def test_no_departure_has_no_name():
  assert not any(o.is_there or o.named for o in outlines(characterised({})))


def test_the_base_cars_own_gain_and_damping_are_no_departure():
  blank = characterised({})
  curve = blank.fitted.problem.mechanism("drive_curve")
  commands, speeds = questions(blank, curve)
  unit = projection(blank, curve)[1]
  found = {o.curve: o for o in outlines(characterised({"drive_curve": 0.3 * unit[:, 0] + 0.2 * unit[:, 1]}))}
  assert not found["drive_curve"].is_there
  assert np.isfinite(answer([curve], np.full(10, 0.1), situation(blank, commands, speeds))).all()


def test_a_car_driven_by_a_duty_is_asked_in_volts():
  blank = characterised({})
  curve, plain = blank.fitted.problem.mechanism("drive_curve"), SimpleNamespace(twin=blank.twin, fitted=blank.fitted)
  commands, _ = questions(plain, curve)
  duty = dataclasses.replace(CAR, drive="duty", supply_voltage=8.0)
  blank.fitted.problem.observations.stretches.segments.commands[..., 0] /= 8.0
  plain.twin = SimpleNamespace(vehicle=duty)
  np.testing.assert_allclose(questions(plain, curve)[0], commands)


def named(*mechanisms):
  values = {p.name: 0.1 for m in select(mechanisms) for p in m.parameters}
  return Form(mechanisms, values, values, 1.0, 1.0)


def outline(*forms):
  return Outline("steering_curve", ("steering_curve_left_1",), np.zeros(1), np.ones(1), 0.0, forms)


def test_a_name_keeps_what_is_told_of_in_the_end():
  pair, single = named("steering_gain_error", "steering_saturation"), named("steering_saturation")
  found = left_with(outline(pair), ["steering_saturation"]).named
  assert found.mechanisms == ("steering_saturation",) and set(found.values) == set(found.std) == set(single.values)
  assert left_with(outline(pair), pair.mechanisms) == outline(pair)


def test_a_curve_whose_name_is_not_told_of_does_not_depart():
  left = left_with(outline(named("steering_gain_error")), ["battery_sag"])
  assert not left.is_there and left.named is None


def test_a_curve_without_a_name_departs_whatever_is_told_of():
  refused = dataclasses.replace(named("steering_gain_error"), p_value=0.0)
  assert left_with(outline(refused), []).is_there


def refused(*mechanisms, error):
  return dataclasses.replace(named(*mechanisms), p_value=0.0, misfit=error)


def test_a_curve_that_all_forms_are_refused_for_is_nearly_the_simplest_that_leaves_next_to_nothing():
  """Without the departure the errors are 50 % larger; the forms leave 80, 16 and 2 % of that."""
  forms = [refused("steering_gain_error", error=1.4), refused("steering_saturation", error=1.08)]
  richer = refused("steering_gain_error", "steering_saturation", error=1.01)
  drawn = dataclasses.replace(outline(*forms, richer), without=1.5)
  assert drawn.named is None and drawn.nearly is drawn.told is forms[1]
  assert drawn.left(forms[1]) == pytest.approx(0.16)


def test_a_curve_is_nearly_nothing_where_it_has_a_name_or_does_not_depart_or_nobody_asked():
  almost = refused("steering_saturation", error=1.01)
  drawn = dataclasses.replace(outline(almost), without=1.5)
  assert drawn.nearly is almost
  assert dataclasses.replace(drawn, forms=(named("steering_gain_error"), almost)).nearly is None
  assert dataclasses.replace(drawn, departs=1.0).told is None
  assert dataclasses.replace(drawn, without=1.0).told is None


@pytest.mark.parametrize("p, possible", [(0.03, True), (0.01, False)])
def test_a_form_is_refused_by_its_own_test_however_many_are_asked(p, possible):
  form = Form(("steering_asymmetry",), {"a": 1.0}, {"a": 0.1}, 1.2, p)
  others = tuple(Form((f"other_{k}",), {"a": 1.0}, {"a": 0.1}, 2.0, 0.0) for k in range(9))
  drawn = Outline("steering_curve", ("h",), np.zeros(1), np.ones(1), 1e-6, (form, *others), asked=3)
  assert (drawn.named is form) is possible
  assert dataclasses.replace(drawn, departs=0.01).possible == ()  # 1 % is no departure of three curves
