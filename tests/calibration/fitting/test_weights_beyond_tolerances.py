"""Weights where a tolerance binds: what goes on beyond it is no noise of the channel in which it shows."""

import dataclasses

import numpy as np
import pytest

from calibration.fitting.likelihood import weighting_from
from calibration.fitting.observations import CHANNELS
from calibration.fitting.recalibration import RecalibratedTwin, settled
from calibration.fitting.tolerances import weighed_beyond
from tests.calibration.diagnosis import diagnosis_rig as rig

GYRO = CHANNELS.index("yaw_rate")
STIFF = {n: dataclasses.replace(rig.BASE[n], std=1e-3 * rig.BASE[n].nominal) for n in rig.BASE.names}


def recalibrated(scale: float) -> RecalibratedTwin:
  """A gyro that is allowed for within 2 % and reads a share too much, weighed by what the fit leaves."""
  twin = rig.LinearTwin(("gyro_scale",))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"gyro_scale": scale}))
  allowed = dataclasses.replace(twin.parameters["gyro_scale"], lower=-0.02, upper=0.02, std=0.007, assumed=True)
  base = rig.BASE.replace(**STIFF) + [allowed]
  first = settled(problem, {}, base, base.start, 0)
  left = weighting_from(problem.observations, problem.raw(first.theta[None])[0], {})
  return settled(problem.reweighted(left), {}, base, first.fit.theta, 0)


@pytest.mark.parametrize("scale", [-0.2, 0.2])
def test_the_rest_of_what_stopped_at_its_bound_is_no_noise(scale):
  at = recalibrated(scale)
  assert at.fit.at_bound[at.fit.parameters.index("gyro_scale")]
  weighting, worth = weighed_beyond(at.problem, at.fit, at.jacobian, {})
  truth = at.theta.copy()
  truth[at.problem.parameters.index("gyro_scale")] = scale
  wanted = weighting_from(at.problem.observations, at.problem.raw(truth[None])[0], {}).std
  assert weighting.std[GYRO] == pytest.approx(wanted[GYRO], rel=0.1)
  assert weighting.std[GYRO] < 0.8 * at.problem.weighting.std[GYRO] and worth > 10.0
  others = np.arange(len(CHANNELS)) != GYRO
  np.testing.assert_allclose(weighting.std[others], at.problem.weighting.std[others], rtol=0.02)


def test_no_weight_is_of_less_than_the_sensors_noise():
  at = recalibrated(0.2)
  noise = 0.9 * at.problem.weighting.std[GYRO]
  assert weighed_beyond(at.problem, at.fit, at.jacobian, {"yaw_rate": noise})[0].std[GYRO] == pytest.approx(noise)


def test_weights_stay_where_nothing_binds_or_only_the_physics_does():
  free = recalibrated(0.01)
  assert weighed_beyond(free.problem, free.fit, free.jacobian, {})[1] == 0.0
  at = recalibrated(0.2)
  place, own = at.fit.parameters.index("gyro_scale"), at.fit.parameters["gyro_scale"]
  declared = dataclasses.replace(own, lower=-0.02, upper=at.problem.parameters["gyro_scale"].upper)
  fit = dataclasses.replace(at.fit, parameters=at.fit.parameters.replace(gyro_scale=declared))
  fit.theta[place] = declared.upper
  weighting, worth = weighed_beyond(at.problem, fit, at.jacobian, {})
  assert worth == 0.0
  np.testing.assert_array_equal(weighting.std, at.problem.weighting.std)
