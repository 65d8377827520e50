"""A model car's speed controller: what is usual of it."""

import dataclasses

import pytest

from calibration.diagnosis.considered import always_free, considered
from calibration.fitting.tolerances import always_fitted, with_tolerances
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.twin.suited import suited
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.twin.mechanisms.mechanism_bench import changed


def test_it_is_the_engines_to_follow():
  assert changed("drive_one_way", [0.9, 0.8, 0.7, 0.1, 0.2]) == {
    "one_way": 0.9,
    "one_way_brake": 0.8,
    "one_way_neutral": 0.7,
    "one_way_weakness": 0.1,
    "one_way_reverse": 0.2,
  }


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
