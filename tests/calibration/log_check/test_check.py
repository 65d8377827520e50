"""The check of a log: what spoils it is refused before anything is fitted, what is odd is said with its cure."""

import dataclasses
import json

import numpy as np
import pytest

from calibration.log_check import check_log, heed
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from scripts import check
from tests.calibration.log_check.test_pairs import changed, drives
from tests.qcar_twin.recordings.drives import STD, VEHICLE


def lab(runs: list[Recording]) -> DataSet:
  return DataSet("lab", tuple(runs), VEHICLE, STD)


def test_a_sound_log_is_fit_to_be_used_and_says_what_it_can_t_show():
  checked = check_log(lab(drives()))
  assert checked.verdict == "Fit to be used: nothing was found that would spoil a fit."
  assert {s.physics: s.verdict for s in checked.shown}["reverse"] == "none"
  assert "reverse: not shown, no driving backwards" in [f.text for f in checked.of("note")]
  assert heed(checked.dataset) == ()


@pytest.mark.parametrize(
  ("channel", "scale", "says"),
  [
    ("yaw_rate", -1.0, "yaw_rate and pose_yaw say the contrary of turning: one of them has the wrong sign"),
    ("accel_x", -1.0, "accel_x and motor_speed say the contrary of speeding up and slowing down"),
    ("steering_command", -1.0, "yaw_rate and steering_command and motor_speed say the contrary of answering the"),
    ("motor_speed", 2.5, "correct gear_ratio or wheel_radius in [vehicle]"),
  ],
)
def test_sensors_that_contradict_each_other_stop_a_fit(channel, scale, says):
  runs = [r.replace(streams={k: s for k, s in r.streams.items() if k != "accel_y"}) for r in drives()]
  dataset = lab([changed(r, channel, scale=scale) for r in runs])
  checked = check_log(dataset)
  assert says in checked.of("spoils")[0].text and checked.verdict.startswith("Not fit to be fitted as it is: ")
  with pytest.raises(RecordingError, match="data set 'lab': "):
    heed(dataset)


def test_a_late_gyro_a_wrong_radius_and_a_held_value_are_told_with_their_size():
  runs = []
  for run in drives():
    run = changed(changed(run, "yaw_rate", late=0.05), "motor_speed", scale=1.04)
    stream = run["pose_yaw"]
    streams = {**run.streams, "pose_yaw": Stream(stream.time, np.repeat(stream.value[::4], 4)[: len(stream)])}
    runs.append(run.replace(streams=streams))
  told = heed(lab(runs))
  assert any(t.startswith("motor_speed reads +4.") and "against pose_x, pose_y and pose_yaw" in t for t in told)
  assert any(t.startswith("yaw_rate is ") and "ms late against pose_yaw" in t for t in told)
  assert any("pose_yaw is new 25 times a second only: set hold = true" in t for t in told)


@pytest.mark.parametrize("channel", ["yaw_rate", "pose_yaw", "accel_x", "motor_speed", "steering_command"])
@pytest.mark.parametrize("kept", [1, 2, 15])
def test_a_channel_of_few_samples_is_no_error(channel, kept):
  runs = [r.replace(streams={**r.streams, channel: Stream(*_first(r[channel], kept))}) for r in drives(2)]
  checked = check_log(lab(runs))
  assert not checked.of("spoils") and checked.document()["shown"]


def _first(stream: Stream, count: int) -> tuple[np.ndarray, np.ndarray]:
  return stream.time[:count], stream.value[:count]


def test_a_car_that_never_moves_is_said_in_words():
  time = np.arange(1000) / 100.0
  columns = {"motor_voltage": 0 * time, "steering_command": 0 * time, "motor_speed": 0 * time, "yaw_rate": 0 * time}
  checked = check_log(lab([Recording.from_columns("still", time, columns)]))
  assert not checked.of("spoils") and "drive map: not shown" in checked.of("note")[0].text


def test_the_command_writes_a_page_and_numbers_for_programs(tmp_path, capsys):
  runs = [changed(r, "yaw_rate", late=0.05) for r in drives()]
  write_dataset(tmp_path / "lab", "lab", VEHICLE, STD, runs)
  check.main(check.Config(tmp_path / "lab", tmp_path / "out"))
  said = capsys.readouterr().out
  assert "beware: yaw_rate is 55 ± " in said and f"page: {tmp_path / 'out' / 'check.html'}" in said
  document = json.loads((tmp_path / "out" / "check.json").read_text())
  turning = next(c for c in document["comparisons"] if c["motion"] == "turning")
  assert turning["lag"]["value"] == pytest.approx(0.055, abs=0.001)
  assert document["findings"][0]["channels"] == ["yaw_rate", "pose_yaw"] and document["schema"] == 1
  page = (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
  for text in ("Warnings", "Sensors against each other", "What this driving can show"):
    assert text in page


def test_a_command_of_another_kind_than_the_cars_drive_spoils_a_fit():
  """A duty beside drive = "voltage" was fit to be used, and refused by the fit."""
  assert check_log(lab(drives())).of("spoils") == ()
  other = dataclasses.replace(lab(drives()), vehicle={**VEHICLE, "drive": "duty", "supply_voltage": 8.0})
  (said,) = check_log(other).of("spoils")
  assert "was driven by motor_voltage, but test car is driven by motor_duty" in said.text and said.channels == (
    "motor_duty",
  )
