"""The one table of channels: what a record must say, and what is read from it."""

import dataclasses
import math
import re

import numpy as np
import pytest

from qcar_twin.recordings.channels import CHANNELS, COMMANDS, DRIVE_COMMANDS, Channel, channels_of, register
from qcar_twin.recordings.checks.faults import find_defects
from qcar_twin.recordings.checks.units import check_limits
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests import ROOT
from tests.qcar_twin.recordings.drives import drive, folder_with
from tests.qcar_twin.recordings.loading import refused_run

MEASURED = [name for name, channel in CHANNELS.items() if channel.is_measured]


def test_the_page_names_every_channel():
  page = (ROOT / "docs" / "reference" / "recordings.md").read_text(encoding="utf-8")
  table = page.split("## Channels")[1].split("## dataset.toml")[0]
  assert set(re.findall(r"`(\w+)`", table.split("|---|---|---|")[1].split("\n\n")[0])) == set(CHANNELS)


def without(columns, *names):
  return {name: column for name, column in columns.items() if name not in names}


def test_records_are_kept_under_their_own_names_and_there_is_one_clock():
  assert all(name == channel.name for name, channel in CHANNELS.items())
  assert channels_of("clock") == ("time",)
  assert set(COMMANDS) <= set(channels_of("command"))
  assert set(channels_of("command")) == {*DRIVE_COMMANDS, "steering_command"}


@pytest.mark.parametrize("name", [n for n, c in CHANNELS.items() if c.limit < math.inf])
def test_a_value_beyond_the_limit_is_refused_with_a_scale_that_mends_it(name):
  channel, time = CHANNELS[name], np.arange(100) / 100.0
  beyond = Recording("a", {name: Stream(time, np.full(100, 1.1 * channel.limit)), "pose_score": Stream(time, time)})
  with pytest.raises(RecordingError, match=rf"{name} reaches .*set scale = .* on {name}") as caught:
    check_limits(beyond)
  scale = float(str(caught.value).split("set scale = ")[1].split()[0])
  check_limits(Recording("a", {name: Stream(time, np.full(100, 1.1 * channel.limit * scale))}))
  check_limits(Recording("a", {name: Stream(time, np.full(100, 0.9 * channel.limit))}))


@pytest.mark.parametrize("name", [n for n, c in CHANNELS.items() if c.noisy])
def test_a_noisy_channel_that_stays_is_named_as_frozen_and_any_other_is_not(name):
  time, columns = drive()
  stays = np.where((time > 4.0) & (time < 6.0), 0.3, np.random.default_rng(1).normal(size=time.size))
  notes = lambda channel: find_defects(Recording.from_columns("a", time, columns | {channel: stays}))
  assert any(f"{name} is frozen at 0.3" in note for note in notes(name))
  assert not any("frozen" in note for note in notes("pose_score"))


def test_commands_keep_their_value_and_measurements_are_interpolated():
  time = np.array([0.0, 1.0])
  run = Recording("a", {name: Stream(time, time) for name in CHANNELS if name != "time"})
  halfway = {name: column[1] for name, column in run.resample(0.5).items()}
  assert {name for name, value in halfway.items() if value == 0.0} == set(channels_of("command"))
  assert {name for name, value in halfway.items() if value == 0.5} == {"time", *MEASURED}


@pytest.mark.parametrize("drive_command", DRIVE_COMMANDS)
def test_any_drive_command_will_do(tmp_path, drive_command):
  time, columns = drive()
  columns = without(columns, "motor_voltage") | {drive_command: 0.1 * columns["motor_voltage"]}
  (run,) = DataSet.load(folder_with(tmp_path, time, columns)).recordings
  _, commands = run.commands(0.01, (drive_command, "steering_command"))
  assert commands[:, 0] == pytest.approx(columns[drive_command])


def test_without_any_drive_command_the_loader_names_them_all(tmp_path):
  time, columns = drive()
  refused_run(
    tmp_path,
    time,
    without(columns, "motor_voltage", "steering_command"),
    "needed channel 'motor_voltage' is missing",
    *DRIVE_COMMANDS,
  )


def test_a_blank_drive_command_beside_the_one_in_use_is_left_out_with_a_word(tmp_path):
  time, columns = drive()
  data = DataSet.load(folder_with(tmp_path, time, columns | {"speed_command": np.full(time.size, np.nan)}))
  assert "speed_command" not in data.recordings[0]
  assert any("speed_command has no sample" in note for note in data.warnings)


@pytest.mark.parametrize(
  ("changes", "text"),
  [
    ({"name": "roll rate"}, "letters, digits and _"),
    ({"unit": ""}, "a unit"),
    ({"description": ""}, "a description"),
    ({"kind": "measurement"}, "no kind 'measurement'; there are clock, command"),
    ({"limit": -1.0}, "limit must be positive"),
    ({"noise": -0.1}, "noise no less than 0"),
    ({"spikes": 1.0}, "spikes a share"),
    ({"log_units": ()}, "a limit needs log_units"),
    ({"log_units": (("deg/s", 0.0),)}, "factors of log_units"),
  ],
)
def test_a_record_that_says_too_little_is_refused(changes, text):
  good = Channel("roll_rate", "rad/s", "gyro about x", device="imu", limit=15.0, log_units=(("deg/s", 0.0174533),))
  with pytest.raises(ValueError, match=text):
    dataclasses.replace(good, **changes)


def test_a_name_that_is_taken_is_refused_and_the_same_record_twice_is_not():
  assert register(CHANNELS["yaw_rate"]) is CHANNELS["yaw_rate"]
  with pytest.raises(ValueError, match="there is a channel 'yaw_rate' already"):
    register(Channel("yaw_rate", "deg/s", "another"))
  assert CHANNELS["yaw_rate"].unit == "rad/s"
