"""A logged speed may be the car's own: which it is every fit of such a log finds, and no diagnosis names it."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.considered import always_free, considered
from calibration.fitting.tolerances import with_tolerances, without_channel
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR
from tests.qcar_twin.twin.mechanisms.mechanism_bench import CAR, drive, shown

OWN = catalogue()["ground_speed"]


def logged(*names: str, derived: tuple[str, ...] = ()) -> Recording:
  time = np.arange(20) / 50.0
  streams = {name: Stream(time, 0.0 * time) for name in ("motor_voltage", *names)}
  return dataclasses.replace(Recording("run", streams), derived=derived)


def test_it_is_a_share_between_the_wheels_and_the_car():
  track = drive(n=1, steps=40, seed=2).track()
  per_radian = CAR.wheel_radius * CAR.gear_ratio
  own, wheels = track.signal("velocity_x")[0], track.signal("motor_speed")[0] * per_radian
  np.testing.assert_allclose(shown("ground_speed", [1.0], track)["motor_speed"] * per_radian, own)
  np.testing.assert_allclose(
    shown("ground_speed", [0.25], track)["motor_speed"] * per_radian, 0.75 * wheels + 0.25 * own
  )


@pytest.mark.parametrize(
  ("log", "open_"),
  [
    (logged("speed", "pose_x", "pose_y"), True),
    (logged("speed"), False),
    (logged("motor_speed", "pose_x", "pose_y"), False),
    (logged("speed", "motor_speed", "pose_x", "pose_y"), False),
    (logged("speed", "pose_x", "pose_y", derived=("speed",)), False),
  ],
)
def test_it_is_open_where_a_log_has_a_speed_of_unknown_origin_a_pose_and_no_encoder(log, open_):
  twin = Twin(QCAR, considered(None, None, "voltage"))
  priors = with_tolerances(ParameterSet(()), twin, [log])
  assert ("ground_speed" in priors) == open_ == (not without_channel(OWN, [log]))
  assert not open_ or always_free(OWN, priors)
