"""What a session's own trim and gain are worth: pooled over both halves of its recordings, value by value."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves import left_out
from calibration.fitting.observations import CHANNELS

YAW, MOTOR = CHANNELS.index("yaw_rate"), CHANNELS.index("motor_speed")


def half(yaw, motor):
  """Observations of a half and its errors: so many values of each channel, of the sizes given."""
  channel = np.repeat([YAW, MOTOR], [len(yaw), len(motor)])
  return SimpleNamespace(channel=channel, select=lambda name: channel == CHANNELS.index(name)), None, [*yaw, *motor]


def test_every_value_of_a_channel_counts_once(monkeypatch):
  """However many values of other channels its half has: a half may hold hardly any of a channel."""
  halves = {"first": half([3.0], [1.0] * 99), "second": half([1.0] * 9, [1.0])}
  monkeypatch.setattr(left_out, "error_of", lambda *given: {"yaw_rate": 2.0, "motor_speed": 2.0})
  monkeypatch.setattr(left_out, "_with_own_shifts", lambda *given: None)
  monkeypatch.setattr(
    left_out, "driven", lambda found, judged, theta: (*halves[judged[0]][:2], np.array(halves[judged[0]][2]))
  )
  found = left_out._judged(SimpleNamespace(fitted=None), "one", ["first", "second"])
  assert found.own["yaw_rate"] == pytest.approx(np.sqrt((9.0 + 9.0) / 10.0))
  assert found.own["motor_speed"] == pytest.approx(1.0)
