"""Recalibration on the independent car: what it finds is the car, not a false minimum."""

import pytest

from calibration.concealed.proving_ground import make_session
from calibration.fitting.dataset_recalibration import starting_priors
from calibration.fitting.recalibration import begun, recalibrate
from calibration.fitting.tolerances import sensor_error_mechanisms
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
