"""Data sets on disk: the mapping from log columns to channels, the written-and-read-back identity, dataset.toml and its errors."""

import logging
import os
import tomllib

import numpy as np
import pytest
from drives import STD, VEHICLE, drive, folder_with, recording, write_csv, write_manifest

from qcar_twin.dataset import DataSet, write_dataset, write_recording
from qcar_twin.recording import Recording, RecordingError, Stream, UnknownChannelError


def refused(folder, *texts):
  """Loading fails with a text that holds all of `texts`."""
  with pytest.raises(RecordingError) as caught:
    DataSet.load(folder)
  for text in texts:
    assert text in str(caught.value)
  return caught.value


# ---------------------------------------------------------------- loading


def test_a_canonical_folder_loads_as_it_is(tmp_path):
  time, columns = drive()
  data = DataSet.load(
    folder_with(tmp_path, time, columns, top='name = "lab"\ndescription = "d"\nlicence = "MIT"\nsource = "s"')
  )
  assert (data.name, data.description, data.licence, data.source) == ("lab", "d", "MIT", "s")
  assert data.command_timing == "after_measurement"
  assert data.vehicle == VEHICLE and data.vehicle_std == {}
  (run,) = data.recordings
  assert (run.name, run.file, run.role, run.manoeuvre, run.session) == (
    "run",
    "run.csv",
    "identify",
    "unspecified",
    None,
  )
  assert run.channels == tuple(columns)
  for channel, value in columns.items():
    assert (run[channel].time == time).all() and (run[channel].value == value).all()
  assert data.warnings == ()


def test_roles_select_and_names_find_recordings(tmp_path):
  write_dataset(
    tmp_path, "lab", VEHICLE, STD, [recording("a"), recording("b", role="validate"), recording("c", role="holdout")]
  )
  data = DataSet.load(tmp_path)
  assert [[run.name for run in data.role(role)] for role in ("identify", "validate", "holdout")] == [
    ["a"],
    ["b"],
    ["c"],
  ]
  assert data["b"].role == "validate"
  with pytest.raises(RecordingError, match="unknown role 'hold_out'; did you mean 'holdout'"):
    data.role("hold_out")
  with pytest.raises(RecordingError, match="data set 'lab' has no recording 'd'; valid are: a, b, c"):
    data["d"]


def test_scale_and_offset_apply_in_that_order(tmp_path):
  time, columns = drive()
  log = {"duty": columns["motor_voltage"] / 8.0, "v": (columns["motor_speed"] - 3.0) / 2.0}
  channels = 'time = { column = "time" }\nmotor_voltage = { column = "duty", scale = 8.0 }\nmotor_speed = { column = "v", scale = 2, offset = 3 }'
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert run["motor_voltage"].value == pytest.approx(columns["motor_voltage"], abs=1e-12)
  assert run["motor_speed"].value == pytest.approx(columns["motor_speed"], abs=1e-12)


def test_canonical_columns_need_no_mapping_beside_mapped_ones_unless_their_column_is_taken(tmp_path):
  time, columns = drive()
  log = columns | {"throttle": columns["motor_voltage"] / 8.0}
  del log["motor_voltage"]
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='motor_voltage = { column = "throttle", scale = 8.0 }')
  ).recordings
  assert set(run.channels) == set(columns)
  other = tmp_path / "other"
  other.mkdir()
  renamed = 'speed = { column = "motor_speed", scale = 0.003 }'
  (run,) = DataSet.load(folder_with(other, time, columns, channels=renamed)).recordings
  assert "speed" in run and "motor_speed" not in run


def test_wrap_unwraps_the_angle_and_the_offset_survives(tmp_path):
  time, columns = drive()
  turning = 3.0 * time
  log = columns | {"yaw_rate": np.full(time.size, np.nan), "pose_yaw": (turning + np.pi) % (2 * np.pi) - np.pi}
  channels = 'pose_yaw = { column = "pose_yaw", offset = 0.25, wrap = true }'
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert run["pose_yaw"].value == pytest.approx(turning + 0.25, abs=1e-9)


def test_a_wrapped_heading_without_wrap_is_noticed(tmp_path):
  time, columns = drive()
  log = {key: columns[key] for key in ("motor_voltage", "motor_speed")} | {
    "pose_yaw": (3.0 * time + np.pi) % (2 * np.pi) - np.pi
  }
  (warning,) = DataSet.load(folder_with(tmp_path, time, log)).warnings
  assert warning == "run.csv: pose_yaw jumps by more than half a turn; set wrap = true on pose_yaw in [channels]"


def test_gate_multiplies_and_holds_its_last_value_over_blanks(tmp_path):
  time, columns = drive(1.0)
  gate = np.where(np.arange(time.size) < 50, 0.0, 1.0)
  gate[60:70] = np.nan
  log = columns | {"safety": gate}
  channels = 'motor_voltage = { column = "motor_voltage", gate = "safety" }'
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert not run["motor_voltage"].value[:50].any()
  assert (run["motor_voltage"].value[50:] == columns["motor_voltage"][50:]).all()


def test_blank_cells_make_asynchronous_streams(tmp_path):
  time, columns = drive()
  odd = np.arange(time.size) % 2 == 1
  commands = {key: np.where(odd, columns[key], np.nan) for key in ("motor_voltage", "steering_command")}
  sensors = {key: np.where(odd, np.nan, columns[key]) for key in ("motor_speed", "yaw_rate")}
  (run,) = DataSet.load(folder_with(tmp_path, time, commands | sensors)).recordings
  assert (run["motor_voltage"].time == time[odd]).all() and (run["yaw_rate"].time == time[~odd]).all()


# ---------------------------------------------------------------- hold


def held(value, rows):
  return np.repeat(value[::rows], rows)[: value.size]


def test_hold_keeps_one_sample_per_publication(tmp_path):
  time, columns = drive()
  log = columns | {"yaw_rate": held(columns["yaw_rate"], 10)}
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time[::10]).all()
  assert (run["yaw_rate"].value == columns["yaw_rate"][::10]).all()


def test_hold_keeps_sampling_a_true_constant(tmp_path):
  time, columns = drive()
  slow = columns["yaw_rate"].copy()
  slow[300:600] = 0.0  # the car stands for three seconds: the gyro published thirty zeros
  log = columns | {"yaw_rate": held(slow, 10)}
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  standing = (run["yaw_rate"].time >= 3.0) & (run["yaw_rate"].time < 6.0)
  assert standing.sum() == 30 and not run["yaw_rate"].value[standing].any()
  assert np.diff(run["yaw_rate"].time).max() < 0.11


def test_hold_on_a_channel_that_never_changes_takes_the_rate_of_its_neighbours(tmp_path):
  time, columns = drive()
  log = columns | {"yaw_rate": held(columns["yaw_rate"], 10), "steering_command": np.full(time.size, 0.1)}
  channels = (
    'yaw_rate = { column = "yaw_rate", hold = true }\nsteering_command = { column = "steering_command", hold = true }'
  )
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert len(run["steering_command"]) == 120 and (run["steering_command"].value == 0.1).all()


def test_hold_on_samples_that_are_not_held_keeps_them_all(tmp_path):
  time, columns = drive(rate=10.0)
  columns["yaw_rate"] = np.round(columns["yaw_rate"], 2)  # chance repeats of a coarse sensor are samples
  (run,) = DataSet.load(
    folder_with(tmp_path, time, columns, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time).all()


def test_hold_in_a_short_log_keeps_exactly_the_changes(tmp_path):
  time, columns = drive(0.4)
  log = {"motor_voltage": columns["motor_voltage"], "motor_speed": held(columns["motor_speed"], 10)[:40]}
  folder = folder_with(
    tmp_path,
    time,
    log | {"speed": columns["motor_speed"] * 0.003},
    channels='motor_speed = { column = "motor_speed", hold = true }',
  )
  with pytest.raises(RecordingError, match=r"too few samples \(4\)"):
    DataSet.load(folder)
  log = {
    "motor_voltage": columns["motor_voltage"],
    "motor_speed": columns["motor_speed"],
    "yaw_rate": held(columns["yaw_rate"], 10),
  }
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='yaw_rate = { column = "yaw_rate", hold = true }')
  ).recordings
  assert (run["yaw_rate"].time == time[::10]).all()


def test_a_lone_held_constant_keeps_its_span(tmp_path):
  time, columns = drive()
  log = {
    "motor_voltage": columns["motor_voltage"],
    "motor_speed": columns["motor_speed"],
    "battery_voltage": np.full(time.size, 8.2),
  }
  channels = 'battery_voltage = { column = "battery_voltage", hold = true }'
  (run,) = DataSet.load(folder_with(tmp_path, time, log, channels=channels)).recordings
  assert run["battery_voltage"].time.tolist() == [time[0], time[-1]]


def slow_and_fast(rows=10):
  """A log whose clock and held columns come from a slower publisher than its pose, as dart's."""
  time, columns = drive()
  log = {key: held(columns[key], rows) for key in ("motor_voltage", "motor_speed", "yaw_rate")}
  log |= {key: columns[key] for key in ("pose_x", "pose_y", "pose_yaw")}
  return time, held(time, rows), columns, log


def test_time_held_by_a_slower_publisher_is_spread_for_the_faster_channels(tmp_path):
  time, stamps, columns, log = slow_and_fast()
  channels = 'motor_speed = { column = "motor_speed", hold = true }\nyaw_rate = { column = "yaw_rate", hold = true }'
  data = DataSet.load(folder_with(tmp_path, stamps, log, channels=channels))
  (run,) = data.recordings
  assert (run["yaw_rate"].time == time[::10]).all() and (run["yaw_rate"].value == columns["yaw_rate"][::10]).all()
  assert len(run["motor_voltage"]) == 120  # not declared held, but it changes only with the stamp
  assert run["pose_x"].time == pytest.approx(time + 0.005, abs=1e-9)
  assert (run["pose_x"].value == columns["pose_x"]).all()
  assert data.warnings == (
    "run.csv: time repeats because a slower publisher holds it; pose_x, pose_y, pose_yaw change in between and are spread evenly between its stamps",
  )


def test_repeated_time_with_a_changing_held_column_is_still_an_error(tmp_path):
  _, stamps, _, log = slow_and_fast()
  log["yaw_rate"][25] += 0.1
  channels = 'yaw_rate = { column = "yaw_rate", hold = true }'
  refused(
    folder_with(tmp_path, stamps, log, channels=channels),
    "run.csv: time repeats in row 26",
    "held column 'yaw_rate' changes there",
  )


def test_stale_rows_before_the_first_stamp_are_cut_off(tmp_path):
  _, stamps, _, log = slow_and_fast()
  stamps = np.where(np.arange(stamps.size) < 10, 0.0, stamps + 200.0)
  data = DataSet.load(folder_with(tmp_path, stamps, log, channels='yaw_rate = { column = "yaw_rate", hold = true }'))
  (run,) = data.recordings
  assert run.name == "run" and run.start == pytest.approx(200.1)
  assert any(
    "the piece from 0 s to 0.095 s has too few samples (1) and is left out" in warning for warning in data.warnings
  )


# ---------------------------------------------------------------- gaps


def test_a_gap_cuts_the_run_and_is_reported(tmp_path):
  time, columns = drive()
  late = np.where(time < 5.0, time, time + 3.0)
  data = DataSet.load(folder_with(tmp_path, late, columns))
  assert [run.name for run in data.recordings] == ["run#1", "run#2"]
  assert [run.file for run in data.recordings] == ["run.csv", "run.csv"]
  assert data.recordings[0].end == pytest.approx(4.99) and data.recordings[1].start == pytest.approx(8.0)
  assert "run.csv: nothing was logged from 4.99 s to 8 s; the recording is cut there" in data.warnings


def test_the_command_in_force_crosses_the_cut(tmp_path):
  time, columns = drive()
  late = np.where(time < 5.0, time, time + 3.0)
  voltage = np.where(np.arange(time.size) == 100, 3.0, np.nan)
  data = DataSet.load(folder_with(tmp_path, late, {"motor_voltage": voltage, "motor_speed": columns["motor_speed"]}))
  assert data["run#2"]["motor_voltage"].time.tolist() == [8.0] and data["run#2"]["motor_voltage"].value.tolist() == [
    3.0
  ]


def test_jitter_and_single_lost_samples_are_no_gaps(tmp_path):
  time, columns = drive(rate=16.0)
  time = time + np.random.default_rng(1).uniform(-0.012, 0.012, time.size)
  keep = np.arange(time.size) % 37 != 5
  data = DataSet.load(folder_with(tmp_path, time[keep], {key: value[keep] for key, value in columns.items()}))
  assert [run.name for run in data.recordings] == ["run"] and data.warnings == ()


# ---------------------------------------------------------------- writing


def test_what_is_written_comes_back_exactly(tmp_path):
  first = recording("straight_1", session="2024-08-30", manoeuvre="voltage_step")
  time = np.sort(np.random.default_rng(3).uniform(0.0, 7.0, 900)) + 1.7e9
  second = Recording(
    "äöü #2",
    {
      "motor_voltage": Stream(time[::9], np.random.default_rng(4).normal(size=100) / 3.0),
      "speed": Stream(time, np.random.default_rng(5).normal(size=900) * 1e-3),
    },
    role="holdout",
  )
  folder = write_dataset(
    tmp_path / "new" / "set",
    'a "quoted" name',
    VEHICLE,
    STD,
    [first, second],
    description="two\nlines \\ \x7f",
    command_timing="unknown",
    licence="MIT",
    source="here",
  )
  data = DataSet.load(folder)
  assert (data.name, data.description, data.command_timing) == ('a "quoted" name', "two\nlines \\ \x7f", "unknown")
  assert (data.licence, data.source) == ("MIT", "here")
  assert data.vehicle == VEHICLE and data.vehicle_std == STD
  for before, after in zip((first, second), data.recordings, strict=True):
    assert (before.name, before.role, before.manoeuvre, before.session) == (
      after.name,
      after.role,
      after.manoeuvre,
      after.session,
    )
    assert before.channels == after.channels
    for channel in before.channels:
      assert (before[channel].time == after[channel].time).all() and (
        before[channel].value == after[channel].value
      ).all()


def test_pieces_of_a_cut_recording_can_be_written_and_read(tmp_path):
  time, columns = drive()
  cut = DataSet.load(folder_with(tmp_path, np.where(time < 5.0, time, time + 3.0), columns))
  write_dataset(tmp_path / "copy", "copy", cut.vehicle, cut.vehicle_std, cut.recordings)
  assert [run.name for run in DataSet.load(tmp_path / "copy").recordings] == ["run#1", "run#2"]


def test_writing_again_replaces_and_leaves_other_files_alone(tmp_path):
  (tmp_path / "truth.toml").write_text("sealed")
  write_dataset(tmp_path, "one", VEHICLE, STD, [recording("a")])
  write_dataset(tmp_path, "two", VEHICLE, STD, [recording("a", seed=9)])
  assert DataSet.load(tmp_path).name == "two"
  assert sorted(os.listdir(tmp_path)) == ["a.csv", "dataset.toml", "truth.toml"]


@pytest.mark.parametrize(
  "change, text",
  [
    ({"recordings": ()}, "lists no recordings"),
    ({"recordings": "twice"}, "two recordings have one name, 'a'"),
    ({"recordings": "slash"}, "recording name '../a' cannot be a file name"),
    ({"command_timing": "before"}, "unknown command_timing 'before'; valid are: after_measurement, unknown"),
    ({"vehicle": VEHICLE | {"mass": -1.0}}, "[vehicle] mass must be positive, not -1"),
    ({"vehicle": VEHICLE | {"mass": float("nan")}}, "[vehicle] mass must be a finite number"),
    ({"vehicle_std": {"mass": 0.0}}, "[vehicle.std] mass must be positive"),
  ],
)
def test_a_refused_write_changes_nothing(tmp_path, change, text):
  runs = {"twice": [recording("a"), recording("a")], "slash": [recording("../a")]}
  given = {"name": "lab", "vehicle": VEHICLE, "vehicle_std": STD, "recordings": [recording("a")]} | change
  if isinstance(given["recordings"], str):
    given["recordings"] = runs[given["recordings"]]
  with pytest.raises(RecordingError) as caught:
    write_dataset(tmp_path / "new", **given)
  assert text in str(caught.value)
  assert not (tmp_path / "new").exists()


def test_an_interrupted_write_leaves_the_old_data_set_whole(tmp_path, monkeypatch):
  write_dataset(tmp_path, "old", VEHICLE, STD, [recording("a")])
  before = (tmp_path / "a.csv").read_bytes()
  monkeypatch.setattr("qcar_twin.dataset.write_recording", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
  with pytest.raises(KeyboardInterrupt):
    write_dataset(tmp_path, "new", VEHICLE, STD, [recording("a", seed=5)])
  assert (tmp_path / "a.csv").read_bytes() == before and DataSet.load(tmp_path).name == "old"
  assert sorted(os.listdir(tmp_path)) == ["a.csv", "dataset.toml"]


def test_one_recording_can_be_written_as_csv(tmp_path):
  run = Recording("a", {"motor_voltage": Stream([0.0, 0.3], [1.0, 2.0]), "speed": Stream([0.1, 0.3], [0.5, 1 / 3])})
  path = write_recording(tmp_path / "a.csv", run)
  assert path.read_text() == "time,motor_voltage,speed\n0.0,1.0,\n0.1,,0.5\n0.3,2.0,0.3333333333333333\n"


def test_a_csv_that_cannot_be_written_leaves_no_temporary_file(tmp_path, monkeypatch):
  monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
  with pytest.raises(OSError, match="disk full"):
    write_recording(tmp_path / "a.csv", recording())
  assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- dataset.toml


def test_no_folder_no_manifest_or_a_file_instead_say_so(tmp_path):
  refused(tmp_path / "nowhere", "no such folder")
  refused(tmp_path, "holds no dataset.toml; write one with a [vehicle] table")
  (tmp_path / "dataset.toml").write_text("")
  refused(tmp_path / "dataset.toml", "is a file; give the folder")


@pytest.mark.parametrize(
  "toml, text",
  [
    ("name = ", "dataset.toml: is not valid TOML"),
    ("", "lists no recordings; add [[recording]] tables"),
    ("name = 3", "name must be text"),
    ('name = " "', "name must be text"),
    ('comand_timing = "unknown"', "unknown key 'comand_timing'; did you mean 'command_timing'?"),
    ('command_timing = "unknwn"', "unknown command_timing 'unknwn'; did you mean 'unknown'?"),
    ("vehicle = 3", "vehicle must be a table [vehicle], not 3"),
    ("[vehicle]\nmass = -2.7", "[vehicle] mass must be positive, not -2.7"),
    ("[vehicle]\nmass = 0", "[vehicle] mass must be positive, not 0"),
    ('[vehicle]\nmass = "2.7"', "[vehicle] mass must be a finite number, not '2.7'"),
    ("[vehicle]\nmass = true", "[vehicle] mass must be a finite number, not True"),
    ("[vehicle]\nmass = inf", "[vehicle] mass must be a finite number, not inf"),
    ("[vehicle]\nmas = 2.7", "[vehicle] has unknown key 'mas'; did you mean 'mass'?"),
    (
      "[vehicle]\nmax_steering = 30",
      "max_steering is 30 rad, more than a right angle; in degrees? multiply by 0.0174533",
    ),
    ("[vehicle]\nmass = 2.7\n[vehicle.std]\nmass = -0.1", "[vehicle.std] mass must be positive, not -0.1"),
    ("[vehicle]\nmass = 2.7\n[vehicle.std]\nmas = 0.1", "[vehicle.std] has unknown key 'mas'; did you mean 'mass'?"),
    (
      '[channels]\nyawrate = { column = "w" }',
      "[channels] names an unknown channel 'yawrate'; did you mean 'yaw_rate'?",
    ),
    ('[channels]\nyaw_rate = "w"', '[channels] yaw_rate must be a table such as { column = "log column"'),
    ("[channels]\nyaw_rate = { scale = 2.0 }", "[channels] yaw_rate has no column"),
    ("[channels]\nyaw_rate = { column = 3 }", "[channels] yaw_rate column must be text"),
    ('[channels]\nyaw_rate = { column = "w", sacle = 2.0 }', "yaw_rate has unknown key 'sacle'; did you mean 'scale'?"),
    ('[channels]\nyaw_rate = { column = "w", scale = "2" }', "yaw_rate scale must be a finite number, not '2'"),
    ('[channels]\nyaw_rate = { column = "w", scale = 0 }', "yaw_rate scale is 0, which erases the channel"),
    ('[channels]\nyaw_rate = { column = "w", hold = 1 }', "yaw_rate hold must be true or false, not 1"),
    ('[channels]\nyaw_rate = { column = "w", gate = "" }', "yaw_rate gate must be text"),
    ('[recording]\nfile = "a.csv"', "write recordings as [[recording]] tables (two brackets)"),
    ('[[recording]]\nrole = "identify"', "[[recording]] 1 has no file"),
    ('[[recording]]\nfile = "a.csv"', "[[recording]] 1 has no role; valid are: identify, validate, holdout"),
    ('[[recording]]\nfile = "a.csv"\nrole = "train"', "[[recording]] 1 (a.csv) has unknown role 'train'; valid are"),
    ('[[recording]]\nfile = "a.csv"\nrole = "hold-out"', "unknown role 'hold-out'; did you mean 'holdout'?"),
    ('[[recording]]\nfile = 3\nrole = "identify"', "[[recording]] 1 file must be text"),
    (
      '[[recording]]\nfile = "a.csv"\nrole = "identify"\nmanouvre = "oval"',
      "unknown key 'manouvre'; did you mean 'manoeuvre'?",
    ),
    ('[[recording]]\nfile = "a.csv"\nrole = "identify"\nsession = 2024-08-30', "session must be text"),
    (
      '[[recording]]\nfile = "x/a.csv"\nrole = "identify"\n[[recording]]\nfile = "y/a.csv"\nrole = "identify"',
      "two recordings have one name, 'a' (x/a.csv and y/a.csv); give one of them another, name = ",
    ),
    ('[[recording]]\nfile = "a.csv"\nrole = "identify"', "a.csv: no such file in"),
    ('[[recording]]\nfile = "a.xlsx"\nrole = "identify"', "a.xlsx: no such file in"),
  ],
)
def test_dataset_toml_errors_name_the_key_and_the_cure(tmp_path, toml, text):
  (tmp_path / "dataset.toml").write_text(toml, encoding="utf-8")
  refused(tmp_path, text)


def test_an_unknown_channel_error_is_a_key_error_too(tmp_path):
  (tmp_path / "dataset.toml").write_text('[channels]\nyawrate = { column = "w" }')
  assert isinstance(refused(tmp_path), UnknownChannelError | KeyError)


def test_a_byte_order_mark_in_dataset_toml_is_harmless_and_other_encodings_are_named(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns)
  text = (folder / "dataset.toml").read_text()
  (folder / "dataset.toml").write_text(text, encoding="utf-8-sig")
  assert DataSet.load(folder).name == "lab"
  (folder / "dataset.toml").write_text(text.replace("lab", "Labör"), encoding="latin-1")
  refused(folder, "dataset.toml: is not valid TOML")


def test_name_defaults_to_the_folder_and_unused_keys_and_unmeasured_numbers_are_mentioned(tmp_path):
  folder = tmp_path / "field_day"
  folder.mkdir()
  time, columns = drive()
  data = DataSet.load(folder_with(folder, time, columns, top='weather = "dry"', vehicle={"mass": 2.7}))
  assert data.name == "field_day"
  assert data.warnings[0] == "dataset.toml: key 'weather' is not used"
  assert "[vehicle] gives no yaw_inertia, cg_to_front" in data.warnings[1]


def test_further_vehicle_numbers_and_texts_are_kept(tmp_path):
  time, columns = drive()
  data = DataSet.load(folder_with(tmp_path, time, columns, vehicle=VEHICLE | {"imu_x": -0.02, "tyre": "foam"}))
  assert data.vehicle["imu_x"] == -0.02 and data.vehicle["tyre"] == "foam"


def test_the_written_manifest_is_plain_toml(tmp_path):
  write_dataset(tmp_path, "lab", VEHICLE, STD, [recording("a", session="s1")])
  raw = tomllib.loads((tmp_path / "dataset.toml").read_text())
  assert (
    raw["vehicle"]["std"] == STD and raw["recording"][0]["session"] == "s1" and raw["recording"][0]["file"] == "a.csv"
  )


# ---------------------------------------------------------------- columns of the files


def test_a_mapped_column_that_no_file_has_lists_those_that_exist(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns, channels='yaw_rate = { column = "gyro_z" }')
  refused(
    folder,
    "run.csv: yaw_rate is mapped to column 'gyro_z', which does not exist. Columns that exist: time, motor_voltage",
  )
  folder = folder_with(tmp_path, time, columns, channels='yaw_rate = { column = "yawrate" }')
  refused(folder, "did you mean 'yaw_rate'? Columns that exist: time, motor_voltage, steering_command")


def test_a_mapped_column_that_only_some_files_have_leaves_the_channel_out_there(tmp_path):
  time, columns = drive()
  write_csv(tmp_path / "a.csv", time, columns | {"gyro": columns["yaw_rate"]})
  write_csv(tmp_path / "b.csv", time, {key: columns[key] for key in ("motor_voltage", "motor_speed")})
  data = DataSet.load(write_manifest(tmp_path, ("a.csv", "b.csv"), channels='yaw_rate = { column = "gyro" }'))
  assert "yaw_rate" in data["a"] and "yaw_rate" not in data["b"]
  assert data.warnings == ("yaw_rate: column 'gyro' is absent in 1 of 2 files (b.csv, …)",)


def test_a_missing_gate_column_is_an_error(tmp_path):
  time, columns = drive()
  folder = folder_with(tmp_path, time, columns, channels='motor_voltage = { column = "motor_voltage", gate = "armed" }')
  refused(
    folder, "run.csv: the gate of motor_voltage is mapped to column 'armed', which does not exist", "Columns that exist"
  )
  blank = columns | {"armed": np.full(time.size, np.nan)}
  folder = folder_with(tmp_path, time, blank, channels='motor_voltage = { column = "motor_voltage", gate = "armed" }')
  refused(folder, "gate column 'armed' of motor_voltage is blank in every row")


@pytest.mark.parametrize("missing", ["time", "motor_voltage"])
def test_missing_needed_channels_say_how_to_map_them(tmp_path, missing):
  time, columns = drive()
  if missing == "time":
    write_csv(tmp_path / "run.csv", time, columns)
    text = (tmp_path / "run.csv").read_text().replace("time,", "seconds,", 1)
    (tmp_path / "run.csv").write_text(text)
    folder = write_manifest(tmp_path)
  else:
    folder = folder_with(tmp_path, time, {key: value for key, value in columns.items() if key != missing})
  refused(folder, f"run.csv: needed channel '{missing}' is missing; add {missing} = {{ column = ", "Columns that exist")


def test_speed_or_motor_speed_is_needed(tmp_path):
  time, columns = drive()
  refused(
    folder_with(tmp_path, time, {"motor_voltage": columns["motor_voltage"]}),
    "neither 'motor_speed' nor 'speed' is there",
  )


def test_a_misspelt_column_is_an_unknown_channel_unless_a_mapping_says_which_columns_count(tmp_path):
  time, columns = drive()
  log = {key: value for key, value in columns.items() if key != "yaw_rate"} | {
    "yaw_rte": columns["yaw_rate"],
    "humidity": columns["yaw_rate"],
  }
  error = refused(
    folder_with(tmp_path, time, log), "run.csv: unknown channel 'yaw_rte'; did you mean 'yaw_rate'?", "[channels]"
  )
  assert isinstance(error, KeyError)
  (run,) = DataSet.load(
    folder_with(tmp_path, time, log, channels='motor_voltage = { column = "motor_voltage" }')
  ).recordings
  assert "yaw_rate" not in run


def test_warnings_are_logged_as_well(tmp_path, caplog):
  time, columns = drive()
  columns["pose_score"] = np.full(time.size, np.nan)
  with caplog.at_level(logging.WARNING):
    data = DataSet.load(folder_with(tmp_path, time, columns))
  assert data.warnings == ("run.csv: pose_score has no sample, every cell is blank; the channel is left out",)
  assert data.warnings[0] in caplog.text
