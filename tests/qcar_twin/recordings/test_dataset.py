"""Data sets on disk: the mapping from log columns to channels, dataset.toml and its errors."""

import logging
import tomllib

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import ROLES, RecordingError, UnknownChannelError
from tests.qcar_twin.recordings.drives import STD, VEHICLE, drive, folder_with, recording, write_csv, write_manifest
from tests.qcar_twin.recordings.loading import refused

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
  runs = [recording(name, seed=k, role=role) for k, (name, role) in enumerate(zip("abc", ROLES, strict=True))]
  write_dataset(tmp_path, "lab", VEHICLE, STD, runs)
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
  channels = (
    'time = { column = "time" }\nmotor_voltage = { column = "duty", scale = 8.0 }\n'
    'motor_speed = { column = "v", scale = 2, offset = 3 }'
  )
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


def test_one_long_log_gives_runs_of_every_role(tmp_path):
  time, columns = drive(30.0)
  parts = [("identify", "to = 10.0"), ("validate", "from = 10.0\nto = 20"), ("holdout", "from = 20.005")]
  write_csv(tmp_path / "run.csv", time, columns)
  tables = [f'[[recording]]\nfile = "run.csv"\nrole = "{role}"\n{span}' for role, span in parts]
  (tmp_path / "dataset.toml").write_text("\n".join(['name = "lab"', *tables]), encoding="utf-8")
  data = DataSet.load(tmp_path)
  assert [(r.name, r.role) for r in data.recordings] == [
    ("run", "identify"),
    ("run_10s", "validate"),
    ("run_20.005s", "holdout"),
  ]
  spans = [r["yaw_rate"].time[[0, -1]] for r in data.recordings]
  np.testing.assert_allclose(spans, [(0.0, 10.0), (10.0, 20.0), (20.01, 29.99)])
  assert data["run_20.005s"]["motor_voltage"].time[0] == 20.005  # the command in force there
  refused(
    write_manifest(tmp_path, extra="from = 50.0"), "run.csv", "a part from 50 s", "from 0 s to 29.99 s", "correct"
  )
  refused(write_manifest(tmp_path, extra="from = 5\nto = 2"), "(run.csv) ends at 2 s, before it begins (5 s)", "swap")
  refused(write_manifest(tmp_path, extra='from = "start"'), "from must be a finite number")


@pytest.mark.parametrize("wrap", ["", ", wrap = true", ", wrap = false"])
def test_a_wrapped_heading_is_unwrapped_with_a_note_unless_it_is_said_what_it_is(tmp_path, wrap):
  time, columns = drive()
  log = {key: columns[key] for key in ("motor_voltage", "motor_speed")} | {
    "pose_yaw": (3.0 * time + np.pi) % (2 * np.pi) - np.pi
  }
  channels = f'pose_yaw = {{ column = "pose_yaw"{wrap} }}' + "".join(
    f'\n{name} = {{ column = "{name}" }}' for name in ("time", "motor_voltage", "motor_speed")
  )
  data = DataSet.load(folder_with(tmp_path, time, log, channels=channels))
  yaw = data["run"]["pose_yaw"].value
  assert np.ptp(yaw) == pytest.approx(2 * np.pi if "false" in wrap else 3.0 * time[-1], abs=0.04)
  note = (
    "run.csv: pose_yaw jumps by more than half a turn (6 times) and is unwrapped; set wrap = true on pose_yaw in "
    "[channels] if that is right, wrap = false to keep the jumps"
  )
  assert data.warnings == (() if wrap else (note,))


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


# ---------------------------------------------------------------- dataset.toml


def test_no_folder_no_manifest_or_a_file_instead_say_so(tmp_path):
  refused(tmp_path / "nowhere", "no such folder")
  refused(tmp_path, "holds no dataset.toml; qcar-twin new", "or write one with a [vehicle] table")
  (tmp_path / "dataset.toml").write_text("")
  refused(tmp_path / "dataset.toml", f"is a file; give the folder that holds it, {tmp_path}")
  (tmp_path / "drive.csv").write_text("")
  refused(tmp_path / "drive.csv", "is a file; give the folder that holds dataset.toml; of a log, qcar-twin new")


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
  refused(folder, "dataset.toml: is not UTF-8 text")


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
    without = (missing, "steering_command")
    folder = folder_with(tmp_path, time, {key: value for key, value in columns.items() if key not in without})
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
