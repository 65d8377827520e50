"""The step of a fit: what halving it moves, in multiples of what a channel's sensor makes while the car drives.

A third is wanted. What stands above it is of a few tenths of a second in which the drive reverses and all wheels slide:
it is bounded so that it can only shrink.
"""

import functools

import numpy as np
import pytest

from calibration.concealed.proving_ground import make_session
from calibration.concealed.second_car import make_second_session
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.observations import observe
from calibration.fitting.windows import Cut
from qcar_twin.plant import SUBSTEPS
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

MOST = {
  "first": {"accel_x": 0.5},
  "second": {"motor_speed": 0.7, "accel_x": 0.8},
}  # and a third of all others
MAKE = {"first": make_session, "second": make_second_session}


@functools.cache
def made(car):
  """A car's session; both engines drive it."""
  return MAKE[car](71, (), "compact")


@pytest.mark.slow
@pytest.mark.parametrize("car", MAKE)
@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_halving_the_step_of_a_fit_moves_channels_little(car, engine):
  session = made(car)
  vehicle = Vehicle.from_dataset(session.vehicle, session.vehicle_std)
  observations, predicted = observe(session.recordings, vehicle, Cut(most=LONGEST)), []
  for substeps in (SUBSTEPS, 2 * SUBSTEPS):
    twin = Twin(vehicle, substeps=substeps, threads=1, engine=engine)
    theta = twin.parameters.nominal
    predicted.append(observations.predict(twin.rollout(theta[None], observations.stretches.segments))[0])
  noise, moved = residual_floor(driving_noise(session.recordings)), predicted[1] - predicted[0]
  sizes = {n: np.sqrt(np.mean(moved[observations.select(n)] ** 2)) / noise[n] for n in observations.present}
  assert len({r.name for r in session.recordings}) >= 8 and len(sizes) == 7
  assert all(size < MOST[car].get(name, 1 / 3) for name, size in sizes.items()), sizes
