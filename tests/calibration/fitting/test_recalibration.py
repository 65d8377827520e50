"""Recalibration on the independent car: what it finds is the car, not a false minimum."""

import pytest

from calibration.concealed.proving_ground import make_session
from calibration.fitting.dataset_recalibration import starting_priors
from calibration.fitting.first_guess import held_close
from calibration.fitting.recalibration import begun, recalibrate
from calibration.fitting.tolerances import sensor_error_mechanisms, with_tolerances
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

RUNS = ("voltage_steps", "drive_brake", "ramp_steer_fast", "circles_slow", "standstill")


@pytest.mark.slow
def test_wheels_that_slide_do_not_bend_the_car():
  """A car with more grip than the first guess brakes so hard that the guess's wheels spin backwards.

  Fitted all at once from there, the centre of gravity went 25 mm forward, nine of its standard deviations, to make up
  for a friction coefficient 0.12 too low.
  """
  session = make_session(12345, design="compact", noise=0.5)
  truth = session.truth["car"]
  vehicle = Vehicle.from_dataset(session.vehicle, session.vehicle_std)
  twin = Twin(vehicle, sensor_error_mechanisms(catalogue().values()), engine="reduced")  # as fits search
  recordings = [r for r in session.recordings if r.name in RUNS]
  minimum = recalibrate(begun(twin, recordings, starting_priors(recordings, twin, None))).fit
  fitted = minimum.named()
  assert fitted["friction_coefficient"] == pytest.approx(truth["friction"], abs=0.06)
  assert fitted["cg_to_front"] == pytest.approx(truth["cg_to_front"], abs=3.0 * session.vehicle_std["cg_to_front"])
  assert fitted["mass"] == pytest.approx(truth["mass"], abs=0.08)


def test_a_rough_fit_holds_a_limit_where_it_acts_and_a_later_one_does_not():
  """A servo so fast that its rate shows nowhere has no slope, and a poor twin may have driven it there."""
  vehicle = Vehicle.load()
  twin = Twin(vehicle, [catalogue()["steering_rate_limit"]], engine="reduced")
  base = with_tolerances(twin.base, twin)
  held, free = held_close(base)["steering_inverse_rate"], base["steering_inverse_rate"]
  assert held.nominal == free.start and held.std == pytest.approx(0.01 * free.start)
  assert free.nominal == free.null == 0.0 and (held.lower, held.upper) == (free.lower, free.upper)
  same = set(base.names) - {"steering_inverse_rate", "mass", "yaw_inertia", "cg_to_front", "cg_height_offset"}
  assert all(held_close(base)[name] == base[name] for name in same)
