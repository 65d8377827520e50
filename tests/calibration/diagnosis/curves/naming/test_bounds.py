"""Bounds of forms that are the nominal car's go further where a fit ends there; laws and everything else stay."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves.naming import bounds
from calibration.diagnosis.curves.naming.bounds import as_wide, said, widened
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.mechanisms import catalogue

ZONE = catalogue()["drive_dead_zone"].parameters[0]
SHARE, LIMIT = catalogue()["coast_freewheel"].parameters
OUTSIDE = Parameter("mass", 2.0, 1.0, 3.0, "kg")


@dataclasses.dataclass
class Model:
  free: ParameterSet
  values: np.ndarray
  mechanisms: tuple[str, ...]
  theta: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(4))


PROBLEM = SimpleNamespace(parameters=ParameterSet([ZONE, SHARE, LIMIT, OUTSIDE]), mechanism=catalogue().get)


def ended(**values):
  free = ParameterSet([p for p in PROBLEM.parameters if p.name in values])
  forms = ("drive_dead_zone", "coast_freewheel")
  return Model(free, np.array(list(values.values())), tuple(f for f in forms if f in values))


def test_a_form_with_a_unit_that_ended_at_its_bound_goes_twice_as_far_once():
  model = ended(drive_dead_zone=ZONE.upper)
  assert widened(PROBLEM, model)
  assert model.free["drive_dead_zone"].upper == 2.0 * ZONE.upper
  model.values[0] = 2.0 * ZONE.upper
  assert not widened(PROBLEM, model)
  assert model.free["drive_dead_zone"].upper == 2.0 * ZONE.upper


@pytest.mark.parametrize(
  "values",
  [
    {"drive_dead_zone": 0.9 * ZONE.upper},
    {"drive_dead_zone": 0.0},  # there is nothing less than none
    {"coast_freewheel": SHARE.upper, "coast_freewheel_voltage": 0.3},  # nor more than the whole
    {"mass": OUTSIDE.upper},  # a scale tells it
  ],
)
def test_what_is_inside_a_law_or_no_form_stays(values):
  model = ended(**values)
  before = model.free
  assert not widened(PROBLEM, model)
  assert model.free.names == before.names and all(a is b for a, b in zip(model.free, before, strict=True))


def test_a_lower_bound_above_zero_goes_to_half():
  model = ended(coast_freewheel=0.5, coast_freewheel_voltage=LIMIT.lower)
  assert widened(PROBLEM, model)
  assert model.free["coast_freewheel_voltage"].lower == 0.5 * LIMIT.lower


def test_models_made_of_a_widened_one_keep_its_room_and_its_values():
  base = ended(drive_dead_zone=ZONE.upper, mass=2.5)
  widened(PROBLEM, base)
  base.values[0] = 1.3 * ZONE.upper
  made = ended(drive_dead_zone=ZONE.upper, mass=2.5)  # as if clipped
  as_wide(made, base, PROBLEM)
  assert made.free["drive_dead_zone"].upper == 2.0 * ZONE.upper and made.free["mass"] is OUTSIDE
  assert made.values[0] == made.theta[0] == 1.3 * ZONE.upper and made.values[1] == 2.5


def test_what_a_form_had_freed_is_held_to_its_tolerance_again_without_it():
  base = ended(drive_dead_zone=0.5 * ZONE.upper)
  without = ended(drive_dead_zone=0.05 * ZONE.upper)
  without.mechanisms = ()
  without.free = ParameterSet([dataclasses.replace(ZONE, upper=0.1 * ZONE.upper)])
  as_wide(without, base, PROBLEM)
  assert without.free["drive_dead_zone"].upper == 0.1 * ZONE.upper and without.values[0] == 0.05 * ZONE.upper


def test_a_fitted_twin_is_fitted_on_where_it_has_more_room_and_left_alone_elsewhere(monkeypatch):
  asked = []
  monkeypatch.setattr(bounds, "settled", lambda problem, noise, free, start, shift: asked.append(free) or "fitted on")
  made = lambda model: SimpleNamespace(
    problem=PROBLEM, noise_models={}, command_shift=0, fit=SimpleNamespace(parameters=model.free, theta=model.values)
  )
  inside, at = made(ended(drive_dead_zone=0.5)), made(ended(drive_dead_zone=ZONE.upper))
  assert bounds.with_room(inside, ("drive_dead_zone",)) is inside and not asked
  assert bounds.with_room(at, ("drive_dead_zone",)) == "fitted on"
  assert asked[0]["drive_dead_zone"].upper == 2.0 * ZONE.upper


def test_it_is_said():
  model = ended(drive_dead_zone=ZONE.upper, mass=3.0)
  assert said(PROBLEM, model.mechanisms, model.free) == ()
  widened(PROBLEM, model)
  (sentence,) = said(PROBLEM, model.mechanisms, model.free)
  assert "drive_dead_zone" in sentence and f"0 to {ZONE.upper:g} V" in sentence and f"{2.0 * ZONE.upper:g}" in sentence
