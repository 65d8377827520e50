"""The transient fit of the tyres begins where a car that understeers as this one does can be."""

import numpy as np
import pytest

from calibration.identification.transient_single_track import _possible, rear_stiffness, unknowns

RACER = {"mass": 0.041, "yaw_inertia": 27.8e-6, "cg_to_front": 0.029, "cg_to_rear": 0.033, "imu_x": 0.0}
STD = {name: 0.01 * value for name, value in RACER.items()}


@pytest.mark.parametrize(("gradient", "begins_elsewhere"), [(0.011, True), (0.001, False), (-0.01, False)])
def test_the_front_stiffness_begins_below_what_no_rear_axle_balances(gradient, begins_elsewhere):
  parameters = unknowns(RACER, STD, gradient, 0.1 * abs(gradient))
  start = _possible(parameters)
  front = float(parameters[0].value(start[0]))
  rear = rear_stiffness(front, gradient, RACER["mass"], RACER["cg_to_front"], RACER["cg_to_rear"])
  assert bool(np.any(start)) == begins_elsewhere
  assert 0.0 < rear < 100.0 * front  # no bound is hit
