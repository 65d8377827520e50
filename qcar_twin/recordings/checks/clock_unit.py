"""Is a clock in seconds? What sensors of rates add up to over a whole log, against how far something else went by then.

A path is the integral of speed, a turn that of the yaw rate, by the log's own clock. So their ratio is the seconds that
are in its unit, however few of its units the log lasts.
"""

from __future__ import annotations

import math

import numpy as np

from qcar_twin.recordings.recording import Recording, RecordingError

_UNITS = {"minutes": 60.0, "hours": 3600.0, "days": 86400.0, "milliseconds": 1e-3, "microseconds": 1e-6}
_EXACT = 1.2  # nearness to a unit, as of all that geometry ties
_SPANS = 40  # of equal length, over whose ends a way and a turn are added up: noise of the places in between is none
_LEAST = 5.0  # m or rad that the larger of the two has to be


def check_clock_unit(recording: Recording) -> None:
  """Raises RecordingError where all witnesses say that the clock counts minutes, hours, milliseconds."""
  way, turn = _by_way(recording), _by_turn(recording)
  ratios = [ratio for ratio in (way, turn) if ratio is not None]
  for unit, seconds in _UNITS.items() if way is not None else ():  # a turn alone may be one in degrees, 57.3-fold
    if all(abs(math.log(ratio / seconds)) < math.log(_EXACT) for ratio in ratios):
      raise RecordingError(
        f"{recording.file or recording.name}: time is in {unit}: by it the car goes {ratios[0]:.3g} times as far "
        f"as its speed or turning rate says; set scale = {seconds:g} on time in [channels], times one that is there"
      )


def _by_way(recording: Recording) -> float | None:
  if not {"speed", "pose_x", "pose_y"} <= set(recording.channels) or "speed" in recording.derived:
    return None
  ends = _ends(recording, "pose_x", "speed")
  x, y = (recording[name].interpolate(ends) for name in ("pose_x", "pose_y"))
  return _ratio(float(np.nansum(np.hypot(np.diff(x), np.diff(y)))), _added(recording, "speed", ends))


def _by_turn(recording: Recording) -> float | None:
  if not {"yaw_rate", "pose_yaw"} <= set(recording.channels):
    return None
  ends = _ends(recording, "pose_yaw", "yaw_rate")
  turn = np.abs(np.diff(recording["pose_yaw"].interpolate(ends)))
  return _ratio(float(np.nansum(turn)), _added(recording, "yaw_rate", ends))


def _ends(recording: Recording, one: str, other: str) -> np.ndarray:
  a, b = recording[one].time, recording[other].time
  return np.linspace(max(a[0], b[0]), min(a[-1], b[-1]), _SPANS + 1)


def _added(recording: Recording, channel: str, ends: np.ndarray) -> float:
  """Sum of the sizes of a rate's integrals over spans."""
  stream = recording[channel]
  area = np.r_[0.0, np.cumsum(0.5 * np.diff(stream.time) * (stream.value[1:] + stream.value[:-1]))]
  return float(np.sum(np.abs(np.diff(np.interp(ends, stream.time, area)))))


def _ratio(went: float, added: float) -> float | None:
  return went / added if max(went, added) > _LEAST and min(went, added) > 0.0 else None
