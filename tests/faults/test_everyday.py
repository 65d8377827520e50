"""Everyday mistakes of files: a stranger's log is read right, or refused with its cause, or said to be unjudged."""

import datetime

import numpy as np
import pytest

from calibration.log_check.check import LogCheck, check_log, load_to_check
from qcar_twin.recordings.first_dataset.place import logs_of, placed, with_rows
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.recording import RecordingError
from tests.faults.falsities import NAMES
from tests.faults.wander import RATE, Array, Columns, wander

DEG = 180.0 / np.pi
BEGAN = datetime.datetime(2025, 10, 5, 13, 28, 47, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
TIME, DRIVEN = wander(77)
LOST = (TIME > 20.0) & (TIME < 25.0)


def text(time=TIME, separator=",", decimal=".", names=NAMES, **changed: Array) -> list[str]:
  """Lines of a CSV: the drive with some channels changed, under a stranger's names."""
  columns: Columns = {names.get(name, name): values for name, values in {**DRIVEN, **changed}.items()}
  stamp = lambda t: t if isinstance(t, str) else f"{t:.9f}"
  rows = zip(time, *columns.values(), strict=True)
  lines = [[stamp(t), *(f"{value:.6f}" for value in cells)] for t, *cells in rows]
  return [
    separator.join(("time", *columns)), *(separator.join(c.replace(".", decimal) for c in cells) for cells in lines)
  ]  # fmt: skip


def stamps(write) -> list[str]:
  return [write(BEGAN + datetime.timedelta(seconds=float(t))) for t in TIME]


def read(folder, lines) -> LogCheck:
  """As `new` drafts it, with the wheelbase and the mass that a person says."""
  (folder / "run.csv").write_bytes(("\r\n".join(lines) + "\r\n").encode("utf-8-sig"))
  logs = with_rows(placed(folder, logs_of((folder / "run.csv",))))
  draft = propose("lab", [table for _, table in logs], wheelbase=0.256, mass=2.7)
  (folder / "dataset.toml").write_text(draft.text, encoding="utf-8")
  return check_log(load_to_check(folder))


def values(check: LogCheck, channel: str) -> tuple[Array, Array]:
  """Time and value over all pieces."""
  streams = [run[channel] for run in check.dataset.recordings if channel in run]
  time, first = np.unique(np.round(np.concatenate([s.time for s in streams]), 6), return_index=True)
  return time, np.concatenate([s.value for s in streams])[first]


def lost(value: Array, instead: float) -> Array:
  return np.where(LOST, instead, value)


POSE = ("pose_x", "pose_y", "pose_yaw")
RIGHT = {
  "semicolons, decimal commas, a byte order mark": lambda: text(separator=";", decimal=","),
  "dates with a time zone": lambda: text(stamps(lambda d: d.isoformat(timespec="milliseconds"))),
  "days first": lambda: text(stamps(lambda d: d.strftime("%d.%m.%Y %H:%M:%S.%f"))),
  "months first, twice twelve hours": lambda: text(stamps(lambda d: d.strftime("%m/%d/%Y %I:%M:%S.%f %p"))),
  "years first": lambda: text(stamps(lambda d: d.strftime("%Y/%m/%d %H:%M:%S.%f"))),
  "the time of day": lambda: text(stamps(lambda d: d.strftime("%H:%M:%S.%f"))),
  "the time of day past midnight": lambda: text(
    stamps(lambda d: (d + datetime.timedelta(hours=10.51)).strftime("%H:%M:%S.%f"))
  ),
  "dates in UTC": lambda: text(stamps(lambda d: d.astimezone(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ"))),
  "nanoseconds since 1970": lambda: text(stamps(lambda d: str(round(d.timestamp() * 1e3) * 10**6))),
  "heading in degrees from 0 to 360": lambda: text(pose_yaw=np.mod(DEG * DRIVEN["pose_yaw"], 360.0)),
  "servo from 0 to 180 degrees, to the right": lambda: text(
    names=NAMES | {"steering_command": "servo_deg"}, steering_command=90.0 - DEG * DRIVEN["steering_command"]
  ),
  "servo in us, 1500 straight on": lambda: text(
    names=NAMES | {"steering_command": "servo_us"}, steering_command=1500.0 - 800.0 * DRIVEN["steering_command"]
  ),
  "each row twice": lambda: [line for row in text() for line in ((row, row) if row[0].isdigit() else (row,))],
}


@pytest.mark.parametrize("name", RIGHT)
def test_it_is_read_as_it_was_driven(tmp_path, name):
  check = read(tmp_path, RIGHT[name]())
  assert not check.of("spoils")
  for channel, driven in DRIVEN.items():
    time, value = values(check, channel)
    assert time - time[0] == pytest.approx(TIME, abs=1e-4), channel
    share = 0.05 if channel == "steering_command" else 2e-5  # its scale is fitted where nobody said it
    apart = value - driven - (value[0] - driven[0] if channel.startswith("pose") else 0.0)
    assert np.abs(apart).max() < share * max(1.0, np.abs(driven).max()), channel


@pytest.mark.parametrize("word", ["#N/A", "NA", "null", "-", "nan", "0.000000", "-999.000000"])
def test_a_lost_track_has_no_samples_whatever_stands_there(tmp_path, word):
  mark = -12345.0
  lines = text(**{name: lost(DRIVEN[name], mark) for name in POSE})
  check = read(tmp_path, [line.replace(f"{mark:.6f}", word) for line in lines])
  assert not check.of("spoils")
  for channel in POSE:
    time, _ = values(check, channel)
    assert not ((time > 20.05) & (time < 24.95)).any() and time.size > TIME.size - 1.02 * LOST.sum() - 2
  assert any("20" in f.text and "pose_x" in f.text for f in check.of("beware"))


def _restarted() -> list[str]:
  half = TIME.size // 2
  return text(np.r_[TIME[:half], TIME[half:] - TIME[half] + 0.003])


REFUSED = {
  "the header again": (lambda: (lines := text())[:2000] + lines[:1] + lines[2000:], "repeats the header"),
  "a row of units": (lambda: (lines := text())[:1] + [",".join("smVrxyzuvw")] + lines[1:], "row 1 holds words"),
  "two drives in one file": (_restarted, "split the file where the logger restarted"),
  "newest row first": (lambda: (lines := text())[:1] + lines[:0:-1], "set sort = true"),
  "minutes": (lambda: text(TIME / 60.0), "time is in minutes"),
  "the time of day in whole seconds": (
    lambda: text(stamps(lambda d: d.strftime("%H:%M:%S"))),
    "write it with more digits",
  ),
  "a gyro's raw counts": (lambda: text(yaw_rate=131.0 * DEG * DRIVEN["yaw_rate"]), "raw counts of a sensor"),
  "a row of means below": (lambda: [*text(), "mean" + ",0.5" * len(DRIVEN)], "'mean' in row 4501"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_with_its_cause(tmp_path, name):
  make, cause = REFUSED[name]
  with pytest.raises(RecordingError, match=cause):
    read(tmp_path, make())


SPOILT = {
  "a place in pixels, y down": (
    {"pose_x": 640.0 + 200.0 * DRIVEN["pose_x"], "pose_y": 480.0 - 200.0 * DRIVEN["pose_y"]},
    "do not agree in driving",
  ),
  "a pose of the other hand": (
    {"pose_y": -DRIVEN["pose_y"], "pose_yaw": -DRIVEN["pose_yaw"]},
    "both say the contrary of the pose's turning; the steering goes with them: the place is mirrored",
  ),
  "a gyro's size": ({"yaw_rate": np.abs(DRIVEN["yaw_rate"])}, "yaw_rate is never negative, though"),
  "a quaternion's z as the heading": ({"pose_yaw": np.sin(0.5 * DRIVEN["pose_yaw"])}, "do not agree in turning"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_its_sensors_contradict_it(tmp_path, name):
  changed, said = SPOILT[name]
  assert any(said in f.text for f in read(tmp_path, text(**changed)).of("spoils"))


def test_counts_of_an_encoder_that_wrap_are_not_taken_for_a_speed(tmp_path):
  counts = np.round(np.cumsum(DRIVEN["speed"]) / RATE * 2e4)
  check = read(tmp_path, text(names=NAMES | {"speed": "encoder"}, speed=np.mod(counts + 32768.0, 65536.0) - 32768.0))
  assert all("speed" in run.derived for run in check.dataset.recordings)
