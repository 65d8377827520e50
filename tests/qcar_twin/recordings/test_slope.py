"""Speeds of what adds up: counts of an encoder, metres of an odometer."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.mapping import slope_of
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import write_csv

PER_METRE = 141.5  # counts of 40 per turn of a wheel of 45 mm


def way(time):
  return 2.0 * time - np.sin(time) + 1.0 * (time > 30.0) * (time - 30.0)  # m, of 1 to 3 and 2 to 4 m/s


def speed(time):
  return 2.0 - np.cos(time) + 1.0 * (time > 30.0)


@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_speed_is_what_counts_change_by_per_second_though_the_counter_begins_anew(bits):
  time = np.arange(3000) / 50.0
  counts = np.floor(PER_METRE * way(time))
  counts = counts if bits is None else (counts + 2.0**bits - 5000.0) % 2.0**bits
  told = slope_of(time, counts / PER_METRE, 1.0 / PER_METRE)
  far = np.abs(told.time - 30.0) > 0.1
  wrong = (told.value - speed(told.time))[far]
  assert np.abs(np.mean(wrong)) < 2e-3 and np.std(wrong) < 0.06 and 9.0 < 1.0 / np.median(np.diff(told.time)) < 50.0


def test_counts_backwards_are_a_negative_speed_and_none_are_none():
  time = np.arange(1000) / 100.0
  counts = np.where(time < 5.0, -np.floor(1000.0 * time), -5000.0)
  told = slope_of(time, 0.01 * counts, 0.01)
  assert told.value[told.time < 4.9] == pytest.approx(-10.0, rel=0.06)
  assert not told.value[told.time > 5.1].any()


def test_a_data_set_maps_counts_and_no_other_channel_has_a_slope(tmp_path):
  time = np.arange(1000) / 50.0
  counts = np.floor(PER_METRE * way(time))
  write_csv(tmp_path / "run.csv", time, {"motor_duty": 0.2 + 0.1 * np.sin(time), "enc": counts})
  manifest = """name = "lab"
[vehicle]
drive = "duty"
[channels]
time = { column = "time" }
motor_duty = { column = "motor_duty" CHANGED}
speed = { column = "enc", slope = true, scale = 0.00706714 }
[[recording]]
file = "run.csv"
role = "identify"
"""
  (tmp_path / "dataset.toml").write_text(manifest.replace(" CHANGED", ""))
  (recording,) = DataSet.load(tmp_path).recordings
  assert np.mean(recording["speed"].value) == pytest.approx(way(time)[-1] / time[-1], rel=0.01)
  (tmp_path / "dataset.toml").write_text(manifest.replace(" CHANGED", ", slope = true"))
  with pytest.raises(RecordingError, match="cannot have slope, which belongs to speed and motor_speed"):
    DataSet.load(tmp_path)
