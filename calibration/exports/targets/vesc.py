"""Gains and offsets of vesc.yaml, the file of the VESC's ROS driver.

  erpm = speed_to_erpm_gain * speed + speed_to_erpm_offset          speed_to_erpm_gain = +-60 p / (2 pi G R_w)
  servo = steering_angle_to_servo_gain * angle + steering_angle_to_servo_offset

p is the motor's number of pole pairs, G R_w its travel per radian; the sign is the present file's.
What the servo's values mean no twin knows: the recordings hold angles that a file's present gains have turned into
them. So the present file is corrected. With the twin's angle = (1 + k) command + d, a wanted angle needs the command
(angle - d) / (1 + k):
gain' = gain / (1 + k), offset' = offset - gain' d.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from calibration.exports.target import Job, Target
from calibration.exports.written import heading, text_lines
from calibration.exports.yaml_numbers import read_numbers, yaml_lines

GAIN, OFFSET = "steering_angle_to_servo_gain", "steering_angle_to_servo_offset"
_ABOUT = {
  "speed_to_erpm_gain": "erpm per m/s", "speed_to_erpm_offset": "erpm",
  GAIN: "servo per rad", OFFSET: "servo at straight ahead", "wheelbase": "m",
}  # fmt: skip


def _write(job: Job, path: Path) -> Sequence[str]:
  pairs, present = job.options.get("pole_pairs", ""), job.options.get("vesc", "")
  if not pairs or not present:
    cure = "--pole-pairs (half of the motor's number of magnets' poles) and --vesc (the vesc.yaml the car drove with)"
    raise ValueError(f"an export to vesc needs {cure}: neither is in a twin")
  before = {key.rsplit(".", 1)[-1]: value for key, value in read_numbers(Path(present)).items()}
  if missing := [name for name in (GAIN, OFFSET) if name not in before]:
    raise ValueError(f"{present}: has no {' and no '.join(missing)}; give the vesc.yaml that the car drove with")
  values, v = job.twin.parameters.named(job.theta), job.twin.vehicle
  here = {m.name for m in job.present}
  share = 1.0 + (values["steering_gain_error"] if "steering_gain_error" in here else 0.0)
  turned = values["steering_offset"] if "steering_offset" in here else 0.0
  radius = v.wheel_radius * (1.0 + (values["wheel_radius_error"] if "wheel_radius_error" in here else 0.0))
  gain = before[GAIN] / share
  per_speed = float(pairs) * 60.0 / (2.0 * math.pi * v.gear_ratio * radius)
  made = {  # the sign is how the motor is wired, which only the present file knows
    "speed_to_erpm_gain": math.copysign(per_speed, before.get("speed_to_erpm_gain", 1.0)),
    "speed_to_erpm_offset": before.get("speed_to_erpm_offset", 0.0),
    GAIN: gain, OFFSET: before[OFFSET] - gain * turned, "wheelbase": v.wheelbase,
  }  # fmt: skip
  text_lines(path, [*heading(job, job.lost(TARGET)), *yaml_lines(made, _ABOUT)])
  return [f"{name}: {before[name]:g} before, {made[name]:g} now" for name in made if name in before]


TARGET = Target(
  name="vesc",
  file="vesc.yaml",
  summary="gains and offsets of the VESC's ROS driver",
  write=_write,
  expresses=lambda mechanism: mechanism.name in ("steering_offset", "steering_gain_error"),
)
