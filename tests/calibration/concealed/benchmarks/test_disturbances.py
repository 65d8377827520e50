"""Independent cars against themselves without floor and draught."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.disturbances import disturbed
from calibration.concealed.benchmarks.known import CARS

SEED = 7


@pytest.mark.slow
def test_floor_and_draught_alone_part_a_car_from_itself():
  session = CARS["first"](SEED)
  size = lambda noise: np.sqrt(np.mean(disturbed("first", SEED, session, noise)["motor_speed"] ** 2))
  assert size(0.0) == 0.0
  assert 1.6 < size(0.2) / size(0.1) < 2.4  # small ones add up; larger ones meet the tyres' limits
