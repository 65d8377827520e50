"""Cars of three sizes from their logs alone: `new`, `check` and a quick calibration, each log by a simulator that
shares nothing with the twin."""

import pytest

from calibration import calibrate
from calibration.log_check.check import check_log, load_to_check
from scripts.new import Config, main
from tests.sizes.cars import CARS
from tests.sizes.logs import write

SECONDS = {"1:43": 8.0, "1:5": 8.0, "full": 16.0}  # of a log; a full-size car takes as much longer to show its commands
SAID = {"1:43": {"mass": 0.041}, "1:5": {"wheelbase": 0.57, "mass": 23.9}, "full": {"wheelbase": 2.579}}
# of the sensor's noise, within which the calibrated twin predicts recordings that it has not seen; a twin that predicts
# them as well as can be has 1
NEAR = 2.0
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=list(CARS))
def size(request) -> str:
  return request.param


@pytest.fixture(scope="module")
def folder(size, tmp_path_factory):
  """A data set as `new` writes it from six short logs and what a person says of the car."""
  place = tmp_path_factory.mktemp("size")
  main(Config(place / "car", (write(size, place / "logs", count=6, seconds=SECONDS[size]),), **SAID[size]))
  return place / "car"


@pytest.fixture(scope="module")
def found(folder):
  return calibrate(load_to_check(folder), against="recordings", quick=True)


def test_the_log_is_sound(size, folder):
  """A few seconds leave some of it unjudged: the clock, a quiet accelerometer, a wheelbase that nobody said."""
  check = check_log(load_to_check(folder))
  assert not check.of("spoils")
  assert all("cannot be judged" in finding.text for finding in check.of("beware"))
  said = "wheelbase" in SAID[size]
  assert said != any("steering_command and wheelbase" in finding.text for finding in check.of("beware"))


def test_the_drafted_car_is_of_the_cars_size(size, folder):
  vehicle = load_to_check(folder).vehicle
  car = CARS[size]
  assert vehicle["cg_to_front"] + vehicle["cg_to_rear"] == pytest.approx(car.wheelbase, rel=0.25)
  assert vehicle["mass"] == pytest.approx(car.mass, rel=0.7)


@pytest.mark.parametrize("channel", ["speed", "yaw_rate"])
def test_the_calibrated_twin_predicts_what_it_has_not_seen(found, channel):
  error = found.errors["validate"][channel]
  assert error.after < 0.5 * error.before
  assert error.after < NEAR * error.noise_floor
