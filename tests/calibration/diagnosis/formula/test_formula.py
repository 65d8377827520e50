"""Force, form and chance on a linear car whose force is known."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.formula.columns import Driven, Fitted
from calibration.diagnosis.formula.dictionary import Group, groups
from calibration.diagnosis.formula.forms import forms_of
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.pulses import WIDTH, Responses
from calibration.diagnosis.formula.recovery import Base, recover
from calibration.diagnosis.formula.selection import Chosen, Grams, by_chance, held_out, shortest, stepwise
from calibration.diagnosis.formula.tables import table_heights, table_knots, table_shapes
from qcar_twin.twin.formula import Term
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

STRETCHES, PULSES, PERIOD = 16, 100, 0.01
PER = int(WIDTH / PERIOD)


def smooth(random, length=40.0, size=1.0):
  """A wandering variable, (S, T)."""
  noise = random.standard_normal((STRETCHES, PULSES * PER + 400))
  kernel = np.exp(-0.5 * (np.arange(-150, 151) / length) ** 2)
  kept = np.stack([np.convolve(row, kernel / np.linalg.norm(kernel), "valid") for row in noise])
  return size * kept[:, : PULSES * PER]


@dataclasses.dataclass
class LinearCar:
  """Two channels answer a force: its running mean, and itself; two parameters move them, too."""

  force: np.ndarray  # (S, K), N
  driven: Driven
  noise: float = 1.0
  scale: float = 20.0

  def responses(self):
    lag = np.tril(np.exp(-0.05 * np.subtract.outer(np.arange(PULSES), np.arange(PULSES))))
    block = np.vstack([3.0 * lag, 5.0 * np.eye(PULSES)]) * self.scale / 10.0
    rows = [np.arange(2 * PULSES) + s * 2 * PULSES for s in range(STRETCHES)]
    return Responses("force_x", rows, [block] * STRETCHES, self.scale)

  def fitted(self, seed=0):
    random, answers = np.random.default_rng(seed), self.responses()
    target = np.concatenate([c @ f / self.scale for c, f in zip(answers.columns, self.force, strict=True)])
    target = target + self.noise * random.standard_normal(len(target))
    jacobian = random.standard_normal((len(target), 2))
    base = Base(target, jacobian, jacobian.T @ jacobian + np.eye(2), jacobian.T @ target)
    stretch = np.repeat(np.arange(STRETCHES), 2 * PULSES)
    witness = stretch * 100 + np.tile(np.repeat(np.arange(PULSES // 20), 20), 2 * STRETCHES)
    return Fitted(base, base.rest, stretch, witness)


def driving(seed=1):
  random, car = np.random.default_rng(seed), Twin(Vehicle(), threads=1).car
  assert isinstance(car, CarDimensions)
  speed, steering = np.maximum(1.2 + smooth(random, size=0.4), 0.2), smooth(random, size=0.2)
  values = {
    "speed": speed, "steering": steering,
    "yaw_rate": speed * steering / 0.26 + smooth(random, size=0.5),
    "accel_x": smooth(random), "accel_y": smooth(random, size=2.0),
    "place_x": np.cumsum(0.01 * speed, axis=1), "place_y": smooth(random, length=80.0, size=1.0),
  }  # fmt: skip
  return Driven(values, np.ones_like(speed), car, PERIOD)


def drag(driven):
  return by_pulse(-1.2 * np.abs(driven.values["yaw_rate"]) * np.sign(driven.values["speed"]), PERIOD)


def test_a_force_is_recovered_within_its_deviation():
  driven = driving()
  car = LinearCar(drag(driven), driven, noise=1.0)
  found = recover(car.fitted().base, car.responses())
  off = found.force * car.scale - car.force
  assert np.std(off) < 0.5 * np.std(car.force)
  assert 0.6 < np.sqrt(np.mean((off / (found.std * car.scale)) ** 2)) < 1.6
  assert found.evidence > 100.0


def test_where_there_is_no_force_there_is_no_evidence():
  driven = driving()
  found = recover(
    LinearCar(np.zeros((STRETCHES, PULSES)), driven).fitted().base, LinearCar(drag(driven), driven).responses()
  )
  assert found.evidence < 3.0


def test_a_formula_is_found_with_its_variable_and_its_size():
  driven = driving()
  car = LinearCar(drag(driven), driven, noise=1.0)
  forms = forms_of(car.responses(), driven, car.fitted(), np.random.default_rng(0))
  assert forms is not None and forms.found
  assert str(forms.best.terms[0]) == "abs(yaw_rate) * sign(speed)"
  assert forms.best.coefficients[0] == pytest.approx(-1.2, abs=4.0 * forms.best.std[0])
  assert forms.chance < 0.02 and forms.stable > 0.9


def test_a_spot_on_the_floor_is_found():
  driven = driving()
  away = (driven.values["place_x"] - 3.0) ** 2 + driven.values["place_y"] ** 2
  car = LinearCar(by_pulse(-2.0 * np.exp(-0.5 * away / 0.5**2), PERIOD), driven, noise=0.5)
  forms = forms_of(car.responses(), driven, car.fitted(), np.random.default_rng(0))
  assert forms is not None and forms.there
  assert np.allclose(forms.best.near, (3.0, 0.0, 0.5), atol=0.12)
  assert forms.best.coefficients[0] == pytest.approx(-2.0, rel=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_noise_has_no_formula(seed: int):
  driven = driving(seed)
  car = LinearCar(np.zeros((STRETCHES, PULSES)), driven)
  forms = forms_of(car.responses(), driven, car.fitted(seed), np.random.default_rng(0))
  assert forms is None or not forms.there


def test_what_no_term_is_like_has_a_table():
  driven = driving()
  ripple = by_pulse(-2.0 * np.cos(2.5 * driven.values["yaw_rate"]), PERIOD)
  car = LinearCar(ripple, driven, noise=0.5)
  fitted = car.fitted()
  forms = forms_of(car.responses(), driven, fitted, np.random.default_rng(0))
  assert forms is not None and forms.there and not forms.found
  names, stiffness = forms.table.names, forms.table.stiffness
  assert "yaw_rate" in names
  heights = table_heights(car.responses(), driven, fitted, names, stiffness)
  said = table_shapes("force_x", driven, table_knots(driven, names)) @ heights
  assert np.corrcoef(said.reshape(-1), ripple.reshape(-1))[0, 1] > 0.9


def test_a_term_more_must_earn_its_length():
  random = np.random.default_rng(0)
  columns = random.standard_normal((400, 5))
  target = 0.8 * columns[:, 2] + random.standard_normal(400)
  grams = Grams.of(columns, target, np.repeat(np.arange(8), 50), np.arange(5))
  offered = [Group((Term((("value", name),)),)) for name in ("speed", "yaw_rate", "accel_x", "accel_y", "steering")]
  steps = stepwise(grams, offered)
  assert shortest(steps).members == (2,)
  assert held_out(grams, np.array([2])).sum() > 60.0
  assert held_out(grams, np.array([0])).sum() < 3.0


def test_a_column_of_zeros_in_a_group_stops_no_search():
  """cos and sin of an angle of a car that never turned: it stopped the formula of a real log."""
  random = np.random.default_rng(0)
  columns = random.standard_normal((400, 3))
  columns[:, 1] = 0.0
  target = 0.8 * columns[:, 0] + 0.3 * columns[:, 2] + random.standard_normal(400)
  grams = Grams.of(columns, target, np.repeat(np.arange(8), 50), np.array([0, 0, 1]))
  offered = [Group((Term((("cos", "yaw"),)), Term((("sin", "yaw"),)))), Group((Term((("value", "speed"),)),))]
  assert [step.members for step in stepwise(grams, offered, most=2)] == [(0,), (0, 1)]


def test_the_shortest_formula_that_holds_nearly_all_is_taken():
  steps = [Chosen((0,), np.full(4, 24.0)), Chosen((0, 1), np.full(4, 25.0))]
  assert shortest(steps) is steps[0]
  assert shortest([Chosen((0,), np.full(4, 20.0)), steps[1]]) is steps[1]


def test_chance_is_uniform_without_an_effect():
  chances = []
  for seed in range(30):
    random = np.random.default_rng(seed)
    columns, target = random.standard_normal((320, 12)), random.standard_normal(320)
    group = np.repeat(np.arange(8), 40)
    chances.append(by_chance(columns, target, group, np.arange(320) // 8, random))
  assert 0.25 < np.mean(chances) < 0.75
  assert min(chances) > 0.002


def test_a_force_along_the_car_is_offered_as_a_resistance_first():
  known = {name: np.zeros((1, 1)) for name in ("speed", "yaw_rate")}
  offered = [str(g.terms[0]) for g in groups("force_x", known)]
  assert offered.index("abs(yaw_rate) * sign(speed)") < offered.index("abs(yaw_rate)")
  assert "abs(yaw_rate) * sign(speed)" not in [str(g.terms[0]) for g in groups("moment_z", known)][:1]
  assert all("place" not in g.variables for g in groups("force_x", known))


def test_other_powers_of_a_variable_are_siblings_and_other_directions_of_travel_are_not():
  driven = driving()
  forms = forms_of(LinearCar(drag(driven), driven).responses(), driven, LinearCar(drag(driven), driven).fitted(),
                   np.random.default_rng(0))  # fmt: skip
  assert forms is not None
  said = [" * ".join(map(str, form.terms)) for form in forms.siblings]
  assert said and all(form.variables == ("yaw_rate",) for form in forms.siblings)
  assert any("square(yaw_rate)" in text for text in said) and "abs(yaw_rate)" not in said
