"""What a calibration's verdict says of recordings that took no part in it."""

from types import SimpleNamespace

import pytest

from calibration.fitting.residual_channels import RESIDUALS
from calibration.twin_calibration.calibration import ChannelError
from calibration.twin_calibration.report import verdict

SPEED = ChannelError(2.9, 0.57, 0.025, "m/s")


def calibrated(**errors):
  return SimpleNamespace(against="recordings", errors={"validate": {"speed": SPEED, **errors}})


@pytest.mark.parametrize("after, worse", [(1.5, True), (0.1405, False), (0.02, False)])
def test_a_channel_that_got_worse_is_named_with_what_to_do(after, worse):
  said = verdict(calibrated(yaw_rate=ChannelError(0.14, after, 0.002, "rad/s")))
  assert "speed 0.57 m/s (before 2.9 m/s)" in said
  assert ("errs more than before the calibration in yaw rate: " in said and "[vehicle.std]" in said) is worse


def test_all_that_got_worse_are_named_whether_they_stand_in_the_headline_or_not():
  worse = ChannelError(0.1, 0.2, 0.01, "m")
  names = f"{RESIDUALS['pose_forward'].words}, {RESIDUALS['pose_turn'].words}"
  assert f"before the calibration in {names}: " in verdict(calibrated(pose_forward=worse, pose_turn=worse))
