"""Whether a log's clock is in seconds, by a gyro and what else turned."""

from qcar_twin.recordings.checks.units import UNIT_CORRELATION, compare
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.recording import Recording

_IN_TIME = 1.2  # factor between gyro and turning, within which the clock is right: nearness to a unit


def in_time(recording: Recording) -> bool:
  """Whether the gyro turns as fast as the heading by the log's clock, or as the path's direction where no heading was
  logged: then neither the clock nor the gyro is in another unit."""
  turning = heading_or_course(recording) if "yaw_rate" in recording else None
  if turning is None:
    return False
  both = recording.replace(streams={"yaw_rate": recording["yaw_rate"], "pose_yaw": turning}, derived=())
  slope, alike = compare(both, {})[0].slope()
  return alike > UNIT_CORRELATION and 1.0 / _IN_TIME < slope < _IN_TIME
