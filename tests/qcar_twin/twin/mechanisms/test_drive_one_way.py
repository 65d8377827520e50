"""A model car's speed controller: driving, braking and neutral in cases worked out by hand, and what is usual of it."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.considered import always_free, considered
from calibration.fitting.tolerances import always_fitted, with_tolerances
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.twin.suited import suited
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.twin.mechanisms.mechanism_bench import CAR, act, motion

VOLT = 0
BACK = 400.0 * 7.1e-5 / 0.0272  # V: back-EMF of the bench car at 400 rad/s
SUPPLY = CAR.duty_supply
ALL = [1.0, 1.0, 1.0, 0.0]  # diodes, chopped braking, open at neutral, a brake of full strength


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_it_does_not_brake_while_it_drives(way):
  driven = motion(3, motor_speed=400.0 * way)
  acting = act("drive_one_way", [1.0, 0.0, 0.0, 0.0], way * np.array([0.6, BACK, 3.0]), VOLT, driven)
  np.testing.assert_allclose(way * acting, [BACK, BACK, 3.0], atol=0.03)


def test_four_quadrants_brake_as_far_as_the_command_is_below_the_back_emf():
  driven = motion(2, motor_speed=400.0)
  np.testing.assert_allclose(
    act("drive_one_way", [0.5, 0.0, 0.0, 0.0], [0.6, 3.0], VOLT, driven), [0.5 * (0.6 + BACK), 3.0], atol=0.03
  )


@pytest.mark.parametrize(("weakness", "strength"), [(0.0, 1.0), (0.4, 0.6)])
def test_it_brakes_by_a_short_circuit_for_a_share_of_the_time(weakness, strength):
  """Half of the supply shorts the motor for half of the time: half of the back-EMF drives current."""
  driven = motion(2, motor_speed=400.0)
  acting = act("drive_one_way", [0.0, 1.0, 0.0, weakness], [-SUPPLY / 2, -SUPPLY], VOLT, driven)
  shorted = BACK * strength * np.array([0.5, 1.0])
  np.testing.assert_allclose(acting, BACK - shorted, atol=1e-3)


def test_at_neutral_it_lets_go_or_drags():
  driven = motion(2, motor_speed=400.0)
  for share in (1.0, 0.3):
    acting = act("drive_one_way", [0.0, 0.0, share, 0.0], [0.0, 3.0], VOLT, driven)
    np.testing.assert_allclose(acting, [share * BACK, 3.0], atol=0.03)


def test_it_brakes_to_standstill_and_drives_backwards_only_after_neutral():
  speed = np.array([400.0, 400.0, 20.0, 0.0, 0.0, 0.0, 0.0])
  commands = [3.0, -2.0, -2.0, -2.0, -2.0, 0.0, -2.0]
  acting = act("drive_one_way", ALL, commands, VOLT, motion(7, motor_speed=speed))
  assert 0.0 < acting[1] < BACK
  np.testing.assert_allclose(acting[3:], [0.0, 0.0, 0.0, -2.0], atol=1e-3)


def test_a_car_that_stands_under_a_command_backwards_is_held():
  stands = motion(4, motor_speed=np.zeros(4))
  np.testing.assert_allclose(
    act("drive_one_way", ALL, [-2.0, -2.0, 0.0, -2.0], VOLT, stands), [0.0, 0.0, 0.0, -2.0], atol=1e-3
  )
  context = dataclasses.replace(stands.context(0), before=np.array([[[0.0, 0.0]]]))
  assert not catalogue()["drive_one_way"].initial(np.array([ALL]), context)["brakes"].any()  # it was told just now
  backwards = motion(2, motor_speed=-100.0)
  np.testing.assert_allclose(act("drive_one_way", ALL, [-2.0, -2.0], VOLT, backwards), -2.0, atol=1e-3)


def test_a_brake_that_holds_a_car_is_not_let_go_while_its_command_is_on_its_way():
  """A delay lets nothing through at first, which nobody told: the command before the log began is not known."""
  mechanism, driven = catalogue()["drive_one_way"], motion(2, motor_speed=0.0)
  driven.commands[..., VOLT] = -2.0
  theta = np.array([ALL])
  state = mechanism.initial(theta, driven.context(0))
  acting = [
    mechanism.command(theta, driven.context(k), state, np.array([[u, 0.0]]))[0, VOLT] for k, u in ((0, 0.0), (1, -2.0))
  ]
  np.testing.assert_allclose(acting, 0.0, atol=1e-3)


def test_forwards_it_drives_at_once():
  backwards = motion(2, motor_speed=np.array([-400.0, 0.0]))
  acting = act("drive_one_way", ALL, [2.0, 2.0], VOLT, backwards)
  np.testing.assert_allclose(acting, 2.0, atol=1e-3)


def test_every_model_of_a_duty_fits_all_of_it_so_no_diagnosis_names_it():
  car = dataclasses.replace(Vehicle.load(), drive="duty")
  twin = Twin(car, considered(None, None, "duty"))
  priors = with_tolerances(ParameterSet(()), twin)
  assert always_free(catalogue()["drive_one_way"], priors)
  assert "drive_one_way" not in always_fitted("voltage")


def test_a_dead_band_is_usual_of_a_duty_alone():
  """And what is sought of one then is no less than that."""
  zone = catalogue()["drive_dead_zone"]
  volts, duty = (dataclasses.replace(Vehicle.load(), drive=d, supply_voltage=8.0) for d in ("voltage", "duty"))
  assert suited([zone], volts) == (zone,)
  (sized,) = suited([zone], duty)
  assert zone.tolerances(CarDimensions.of(volts), {})["drive_dead_zone"] == 0.0
  assert (
    sized.parameters[0].typical == zone.tolerances(CarDimensions.of(duty), {})["drive_dead_zone"] == pytest.approx(0.4)
  )
