"""Cures that messages name, applied as they are written: the log is then read right, and nothing else is said of it."""

import re

import numpy as np
import pytest

from calibration.log_check.check import check_log, load_to_check
from qcar_twin.recordings.recording import RecordingError
from tests.faults.falsities import DEG, FALSITIES, wander
from tests.qcar_twin.recordings.drives import VEHICLE, folder_with, write_manifest


def lines(columns, **cured):
  """[channels] of a log with its channels' own names, some of them as a cure has them."""
  names = ("time", *columns)
  return "\n".join(f'{name} = {{ column = "{name}"{cured.get(name, "")} }}' for name in names)


def said_of(folder):
  """The error, or what spoils a fit, of a log; "" where there is none."""
  try:
    check = check_log(load_to_check(folder))
  except RecordingError as error:
    return str(error), None
  spoiling = check.of("spoils")
  return (spoiling[0].text if spoiling else ""), check


def cures(text):
  """Channel -> what to write, of a message: every "set KEY = NUMBER, … on CHANNEL"."""
  named = {}
  for settings, channel, also in re.findall(r"set ((?:\w+ = -?[\w.]+(?:, )?)+) on (\w+)(?: and on (\w+))?", text):
    for one in filter(None, (channel, also)):
      named.setdefault(one, ", " + settings)
  return named


def falsified(name, seed):
  """A drive, true and as a falsity makes it: falsity, time and columns, false stamps and columns."""
  time, columns = wander(seed)
  falsity = next(f for f in FALSITIES if f.name == name)
  return falsity, time, columns, *falsity.apply(time, columns)


VALUES = {
  "speed in km/h": "speed", "speed in cm/s": "speed", "yaw_rate in deg/s": "yaw_rate", "accel_x in g": "accel_x",
  "accel_y in g": "accel_y", "pose_yaw in degrees": "pose_yaw", "pose_yaw in degrees, wrapped": "pose_yaw",
  "steering_command in degrees": "steering_command",
  "pose_yaw a quarter turn off": "pose_yaw", "motor_voltage about a neutral of 5 V": "motor_voltage",
  "steering_command about 0.6 rad": "steering_command", "pose in mm": "pose_x",
  "pose in mm, with commands and a pose alone": "pose_x",
}  # fmt: skip


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_cure_that_is_named_mends_the_channel_it_names(tmp_path, name, seed):
  channel = VALUES[name]
  falsity, _, columns, stamps, false = falsified(name, seed)
  folder = folder_with(tmp_path, stamps, false, channels=lines(false))
  text, _ = said_of(folder)
  named = cures(text)
  assert channel in named, text
  mended = {other: how for other, how in named.items() if other in falsity.channels}
  after, check = said_of(write_manifest(folder, channels=lines(false, **mended)))
  assert after == "" and check is not None
  (run,) = check.dataset.recordings
  apart = run[channel].value - columns[channel]
  apart -= 2.0 * np.pi * np.round(apart[0] / (2.0 * np.pi)) if channel == "pose_yaw" else 0.0
  assert np.abs(apart).max() < 0.01 * np.abs(columns[channel]).max()


@pytest.mark.parametrize(
  "name", ["pose_yaw turned round", "yaw_rate with the other sign", "accel_x with the other sign",
           "accel_y with the other sign", "steering_command with the other sign"],
)  # fmt: skip
@pytest.mark.parametrize("seed", [1, 2])
def test_of_the_cures_of_a_sign_the_right_one_is_named_and_no_other_ends_all_contradictions(tmp_path, name, seed):
  falsity, _, _, stamps, false = falsified(name, seed)
  named = cures(said_of(folder_with(tmp_path, stamps, false, channels=lines(false)))[0])
  ends = {
    channel: said_of(write_manifest(tmp_path, channels=lines(false, **{channel: how})))[0] == ""
    for channel, how in named.items()
  }
  assert [channel for channel, good in ends.items() if good] == [falsity.channels[0]], (named, ends)


@pytest.mark.parametrize("name", ["time at half speed", "time at twice the speed"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_cure_of_a_clock_that_runs_at_another_speed_mends_it(tmp_path, name, seed):
  _, time, _, stamps, false = falsified(name, seed)
  named = cures(said_of(folder_with(tmp_path, stamps, false, channels=lines(false)))[0])
  assert list(named) == ["time"], "two motions that are off alike have one cause"
  after, check = said_of(write_manifest(tmp_path, channels=lines(false, **named)))
  assert after == "" and check is not None
  assert check.dataset.recordings[-1].end == pytest.approx(time[-1], rel=2e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_where_nothing_tells_a_clock_that_is_said(tmp_path, factor):
  time, columns = wander(3)
  few = {name: columns[name] for name in ("motor_voltage", "steering_command", "pose_x", "pose_y", "pose_yaw")}
  _, check = said_of(folder_with(tmp_path, factor * time, few))
  said = [f.text for f in check.of("beware") if f.channels == ("time",)]
  assert (
    len(said) == 1 and "the clock cannot be judged: nothing in this log measures time apart from its stamps" in said[0]
  )
  _, check = said_of(folder_with(tmp_path, factor * time, few | {"speed_command": columns["speed"]}))
  told = [f.text for f in check.findings if "following the commanded speed" in f.text]
  assert len(told) == 1 and ("the clock" in told[0] or "on time in [channels]" in told[0])


def test_a_commanded_speed_in_another_unit_than_the_measured_one(tmp_path):
  time, columns = wander(4)
  columns = columns | {"speed_command": 3.6 * columns["speed"]}
  del columns["motor_voltage"]
  named = cures(said_of(folder_with(tmp_path, time, columns, channels=lines(columns)))[0])
  assert list(named) == ["speed_command"]
  assert said_of(write_manifest(tmp_path, channels=lines(columns, **named)))[0] == ""


def test_a_speed_with_another_radius_is_told_by_all_that_take_it(tmp_path):
  time, columns = wander(8)
  columns["motor_speed"] = 2.5 * columns.pop("speed") / (VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"])
  named = cures(said_of(folder_with(tmp_path, time, columns, channels=lines(columns)))[0])
  assert list(named) == ["motor_speed"]
  assert said_of(write_manifest(tmp_path, channels=lines(columns, **named)))[0] == ""


def test_a_cure_multiplies_the_scale_that_is_there(tmp_path):
  time, columns = wander(1)
  false = columns | {"speed": 36.0 * columns["speed"]}  # tenths of km/h, of which a person saw the tenths
  folder = folder_with(tmp_path, time, false, channels=lines(false, speed=", scale = 0.1"))
  text, _ = said_of(folder)
  assert "on speed in [channels], times one that is there" in text
  by = float(cures(text)["speed"].split("=")[1])
  after, check = said_of(write_manifest(folder, channels=lines(false, speed=f", scale = {0.1 * by}")))
  assert after == "" and check is not None
  assert check.dataset.recordings[0]["speed"].value == pytest.approx(columns["speed"], abs=1e-4)


@pytest.mark.parametrize("seconds", [0.7, 2.0, 6.0])
def test_the_cure_of_a_late_sensor_moves_it_back(tmp_path, seconds):
  _, _, _, stamps, false = falsified(f"yaw_rate {seconds:g} s late", 4)
  folder = folder_with(tmp_path, stamps, false, channels=lines(false))
  named = cures(said_of(folder)[0])
  after, check = said_of(write_manifest(folder, channels=lines(false, **named)))
  assert after == "" and float(named["yaw_rate"].split("=")[1]) == pytest.approx(seconds, abs=0.02)


def test_the_cure_of_a_clock_in_milliseconds_mends_it(tmp_path):
  time, columns = wander(5)
  folder = folder_with(tmp_path, 1000.0 * time, columns, channels=lines(columns))
  text, _ = said_of(folder)
  assert 'set time = { column = "…", scale = 0.001 }' in text
  after, check = said_of(write_manifest(folder, channels=lines(columns, time=", scale = 0.001")))
  assert after == "" and check.dataset.recordings[0]["speed"].time == pytest.approx(time)


@pytest.mark.parametrize("factor", [0.4, 2.5, 3.0])
def test_the_wheelbase_that_a_message_names_mends_the_steering(tmp_path, factor):
  time, columns = wander(6)
  car = {k: v for k, v in VEHICLE.items() if not isinstance(v, str)}
  lengths = ("cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius")
  scaled = lambda by: car | {k: by * car[k] for k in lengths} | {"mass": 2.7 * by**3, "yaw_inertia": 0.03 * by**5}
  text, _ = said_of(folder_with(tmp_path, time, columns, vehicle=scaled(factor)))
  wheelbase = float(text.split("the car turns like one of wheelbase ")[1].split()[0])
  assert wheelbase == pytest.approx(0.256, rel=0.03)
  after, _ = said_of(write_manifest(tmp_path, vehicle=scaled(wheelbase / 0.256)))
  assert after == ""


@pytest.mark.parametrize("gear", [DEG, 10.486, 1000.0])
def test_the_cure_of_an_inverted_gear_loads(tmp_path, gear):
  time, columns = wander(7)
  car = {k: v for k, v in VEHICLE.items() if not isinstance(v, str)}
  text, _ = said_of(folder_with(tmp_path, time, columns, vehicle=car | {"gear_ratio": gear}))
  write = float(text.split("it is inverted: write ")[1].split()[0])
  after, _ = said_of(write_manifest(tmp_path, vehicle=car | {"gear_ratio": write}))
  assert after == "" and write == pytest.approx(1.0 / gear, rel=1e-4)
