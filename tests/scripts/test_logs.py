"""`new` and `export`, run as a user would: strangers' logs in, files for other viewers out."""

import shutil
import tomllib

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from calibration.log_check.check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from scripts import export, new
from tests import REAL
from tests.qcar_twin.recordings.drives import drive, write_csv
from tests.scripts import tiny_session

real = pytest.mark.skipif(not REAL.is_dir(), reason="the real recordings are not here (../shared/data)")


def stripped(name, folder):
  """A real data set's logs without its dataset.toml, as a stranger has them."""
  shutil.copytree(REAL / name, folder, ignore=shutil.ignore_patterns("dataset.toml"))
  return folder


def tree(folder):
  return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# ---------------------------------------------------------------- logs that are not ours


@real
@pytest.mark.parametrize(
  "name, files", [("qcar_ground", 18), ("cpm_ucar", 1), pytest.param("dart", 35, marks=pytest.mark.slow)]
)
def test_a_strangers_logs_are_read_as_the_person_who_looked_at_them_reads_them(tmp_path, capsys, name, files):
  before = tree(stripped(name, tmp_path / "logs"))
  path = new.main(new.Config(tmp_path / "mine", (tmp_path / "logs",)))
  said = capsys.readouterr().out
  assert "Fit to be used" in said and "missing" not in said and "not yet readable" not in said
  assert (tmp_path / "mine_check" / "check.html").is_file() and tree(tmp_path / "logs") == before
  guessed, known = (
    tomllib.loads((folder / "dataset.toml").read_text())["channels"] for folder in (path.parent, REAL / name)
  )
  duty = {"motor_voltage": "motor_duty"}  # a throttle's volts are a person's knowledge of the pack
  for channel, how in known.items():
    guess = guessed.pop(duty.get(channel, channel))
    assert guess["column"] == how["column"], channel
    assert guess.get("gate") == how.get("gate"), channel
    assert channel == "motor_voltage" or guess.get("hold", False) == how.get("hold", False), channel
  assert guessed == {}
  mine, theirs = DataSet.load(path.parent), DataSet.load(REAL / name)
  assert len({run.file for run in mine.recordings}) == files
  assert sum(run.duration for run in mine.recordings) == pytest.approx(
    sum(run.duration for run in theirs.recordings), rel=0.01
  )
  assert all(mine.role(role) for role in ("identify", "validate", "holdout"))
  assert not check_log(mine).of("spoils")


@real
def test_a_steering_command_is_scaled_to_the_curvature_that_was_measured(tmp_path):
  """The curvature per command is the person's within 5 %, though the wheelbase is not known."""
  stripped("dart", tmp_path / "logs")
  logs = [tmp_path / "logs" / "steering_staircase" / f"stair_0{k}.csv" for k in (1, 2)]
  table = tomllib.loads(new.main(new.Config(tmp_path / "mine", tuple(logs))).read_text())
  curvature = lambda table: (
    table["channels"]["steering_command"]["scale"] / (table["vehicle"]["cg_to_front"] + table["vehicle"]["cg_to_rear"])
  )
  known = tomllib.loads((REAL / "dart" / "dataset.toml").read_text())
  assert curvature(table) == pytest.approx(curvature(known), rel=0.05)


# ---------------------------------------------------------------- where files go


@pytest.fixture
def logs(tmp_path):
  (tmp_path / "a").mkdir()
  for k in (1, 2, 10):
    time, columns = drive(6.0, seed=k)
    write_csv(tmp_path / "a" / f"run_{k}.csv", time, columns)
  (tmp_path / "a" / "notes.txt").write_text("rain")
  return tmp_path / "a"


def test_logs_are_copied_in_natural_order_and_nothing_is_replaced(tmp_path, logs, capsys):
  path = new.main(new.Config(tmp_path / "set", (logs,)))
  files = [entry["file"] for entry in tomllib.loads(path.read_text())["recording"]]
  assert files == ["run_1.csv", "run_2.csv", "run_10.csv"]
  assert {p.name for p in path.parent.iterdir()} == {"dataset.toml", *files}
  before = tree(tmp_path / "set")
  with pytest.raises(RecordingError, match=r"dataset.toml: is there already and is not replaced"):
    new.main(new.Config(tmp_path / "set", (logs,)))
  (tmp_path / "set" / "dataset.toml").unlink()
  with pytest.raises(RecordingError, match=r"run_1.csv: is there already and is not replaced"):
    new.main(new.Config(tmp_path / "set", (logs,)))
  assert tree(tmp_path / "set") | {"dataset.toml": before["dataset.toml"]} == before


def test_logs_that_lie_in_the_folder_stay_where_they_are(tmp_path, logs):
  path = new.main(new.Config(logs, out=tmp_path / "page"))
  assert path == logs / "dataset.toml" and len(DataSet.load(logs).recordings) == 3
  assert (tmp_path / "page" / "check.json").is_file()


def test_what_cannot_be_read_leaves_nothing_behind(tmp_path, logs):
  (logs / "run_3.csv").write_text("time,speed\n0,1\n1,2,3\n")
  with pytest.raises(RecordingError, match="run_3.csv: a row does not fit the header"):
    new.main(new.Config(tmp_path / "set", (logs,)))
  with pytest.raises(RecordingError, match="gone.csv: no such file or folder"):
    new.main(new.Config(tmp_path / "set", (logs / "gone.csv",)))
  (tmp_path / "empty").mkdir()
  with pytest.raises(RecordingError, match="empty: holds no log, it is empty; readable are"):
    new.main(new.Config(tmp_path / "set", (tmp_path / "empty",)))
  assert not (tmp_path / "set").exists()


def test_a_log_whose_columns_say_nothing_is_kept_and_what_is_missing_is_said(tmp_path, capsys):
  time, columns = drive(6.0)
  write_csv(tmp_path / "run.csv", time, {"log(2)": columns["motor_voltage"], "log(3)": columns["motor_speed"]})
  with pytest.raises(RecordingError, match="dataset.toml was written and is not yet readable: run.csv: needed channel"):
    new.main(new.Config(tmp_path / "set", (tmp_path / "run.csv",)))
  assert "missing: motor_speed or speed" in capsys.readouterr().out
  path = tmp_path / "set" / "dataset.toml"
  text = path.read_text().replace('column = "…"', 'column = "log(3)"').replace("# motor_speed or speed", "motor_speed")
  text = text.replace("# motor_voltage or", "#").replace(
    "[channels]", '[channels]\nmotor_voltage = { column = "log(2)" }'
  )
  path.write_text(text)
  assert DataSet.load(path.parent).recordings[0].channels == ("motor_voltage", "motor_speed")


def test_files_without_a_header_are_said_with_the_cure_which_works(tmp_path, capsys):
  time, own = drive(6.0)
  names = ("time", "motor_voltage", "motor_speed", "yaw_rate")
  (tmp_path / "logs").mkdir()
  for k in (1, 2, 3):
    rows = np.stack([time, *(own[name] for name in names[1:])], axis=1)
    np.savetxt(tmp_path / "logs" / f"run_{k}.csv", rows * [1.0, 1.0, k, 1.0], delimiter=",")
  (tmp_path / "logs" / "notes.txt").write_text("rain")
  (tmp_path / "logs" / "columns.txt").write_text("t [s]\nu [V]\nomega [rad/s]\nr [rad/s]\n")
  with pytest.raises(RecordingError, match="is not yet readable"):
    new.main(new.Config(tmp_path / "set", (tmp_path / "logs",)))
  said = capsys.readouterr().out
  assert "no header: run_1.csv and 2 more, whose columns are called column_1 to column_4" in said
  assert 'columns = ["time", "motor_speed", …]' in said and "columns.txt next to them may have them" in said
  path = tmp_path / "set" / "dataset.toml"
  draft = path.read_text(encoding="utf-8")
  assert 'columns = ["column_1", "column_2", "column_3", "column_4"]' in draft
  for called, name in zip(("column_1", "column_2", "column_3", "column_4"), names, strict=True):
    draft = draft.replace(f'"{called}"', f'"{name}"')
  path.write_text(draft, encoding="utf-8")
  assert set(DataSet.load(path.parent).recordings[0].channels) == {"motor_voltage", "motor_speed", "yaw_rate"}


def test_logs_with_names_are_said_nothing_of_a_header(tmp_path, logs, capsys):
  path = new.main(new.Config(tmp_path / "set", (logs,)))
  assert "no header" not in capsys.readouterr().out and "columns = [" not in path.read_text(encoding="utf-8")


# ---------------------------------------------------------------- files for other viewers


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
  """A session, and two twins of its car: as the ruler says, and with the tyres it was driven with."""
  folder = tmp_path_factory.mktemp("tiny")
  data = tiny_session.write(folder / "data", run_in=100)
  twin = Twin(Vehicle.from_dataset(data.vehicle, data.vehicle_std), threads=1)
  named = twin.parameters.named(twin.parameters.nominal)
  true = named | {name: share * named[name] for name, share in tiny_session.TRUTH.items()}
  save_twin(folder / "diagnosed" / "recalibrated.toml", twin, twin.parameters.nominal)
  save_twin(folder / "diagnosed" / "twin.toml", twin, twin.parameters.vector(true))
  return folder


def topics_of(path):
  messages = {}
  with path.open("rb") as file:
    for _, channel, message, content in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
      messages.setdefault(channel.topic, []).append((message.log_time * 1e-9, content))
  return messages


def test_export_of_a_diagnosis_holds_what_was_measured_before_after_errors_and_forces(tiny, capsys):
  (path,) = export.main(
    export.Config(tiny / "out", tiny / "data", ("weave_validate",), diagnosis=tiny / "diagnosed", window=0.0)
  )
  assert str(path) in capsys.readouterr().out
  run, topics = DataSet.load(tiny / "data")["weave_validate"], topics_of(path)
  for name, stream in run.streams.items():
    assert [message.data for _, message in topics[f"/measured/{name}"]] == stream.value.tolist()
  rms = lambda topic: float(np.sqrt(np.mean([message.data**2 for _, message in topics[topic]])))
  for channel, noise in tiny_session.NOISE.items():
    assert rms(f"/error_after/{channel}") < 1.2 * noise < rms(f"/error_before/{channel}")
  assert rms("/error_after/force_y") == pytest.approx(2.7 * rms("/error_after/accel_y"), rel=0.05)
  at, shown = zip(*((t, m.data) for t, m in topics["/after/yaw_rate"]), strict=True)
  there, error = zip(*((t, m.data) for t, m in topics["/error_after/yaw_rate"]), strict=True)
  measured = run["yaw_rate"].interpolate(np.array(there))
  assert measured - np.interp(there, at, shown) == pytest.approx(np.array(error), abs=1e-6)
  assert {"/after/imu", "/after/pose", "/before/twist", "/measured/imu"} <= set(topics)


def test_export_of_a_data_set_alone_and_of_any_log(tiny, tmp_path):
  made = export.main(export.Config(tmp_path / "all", tiny / "data"))
  assert len(made) == len(DataSet.load(tiny / "data").recordings)
  assert not any("/after" in topic or "/error" in topic for topic in topics_of(made[0]))
  time, columns = drive(3.0)
  log = write_csv(tmp_path / "traces.csv", time, {"cross track [m]": columns["yaw_rate"], "note": ["a"] * time.size})
  (path,) = export.main(export.Config(tmp_path / "any", log=log))
  topics = topics_of(path)
  assert list(topics) == ["/log/cross track [m]"]
  assert [m.data for _, m in topics["/log/cross track [m]"]] == columns["yaw_rate"].tolist()


def test_export_says_what_it_lacks(tiny, tmp_path):
  with pytest.raises(ValueError, match="give either --dataset, .* or --log"):
    export.main(export.Config(tmp_path))
  with pytest.raises(ValueError, match="an export to mcap takes no --twin: name the target with --to"):
    export.main(export.Config(tmp_path, tiny / "data", twin=tmp_path / "twin.toml"))
  with pytest.raises(ValueError, match="an export to f1tenth takes no --pole-pairs: leave it out"):
    export.main(export.Config(tmp_path, tiny / "data", to="f1tenth", pole_pairs=2))
  with pytest.raises(RecordingError, match="holds no twin.toml; give the folder that `qcar-twin diagnose --out` wrote"):
    export.main(export.Config(tmp_path, tiny / "data", diagnosis=tmp_path))
  with pytest.raises(RecordingError, match="no recording 'weav_validate'; did you mean 'weave_validate'"):
    export.main(export.Config(tmp_path, tiny / "data", ("weav_validate",)))


def test_the_timing_that_was_fitted_is_in_the_twin_file(tiny, tmp_path):
  twin, theta = load_twin(tiny / "diagnosed" / "twin.toml", threads=1)
  save_twin(tmp_path / "twin.toml", twin, theta, command_shift=-1)
  assert export.fitted_shift(None, tmp_path / "twin.toml") == -1
  assert export.fitted_shift(tiny / "diagnosed" / "twin.toml", None) == 0
  text = (tmp_path / "twin.toml").read_text(encoding="utf-8")
  (tmp_path / "twin.toml").write_text(text.replace("command_shift = -1", "command_shift = 0.5"), encoding="utf-8")
  with pytest.raises(ValueError, match="command_shift must be a whole number of control periods, not 0.5"):
    export.fitted_shift(tmp_path / "twin.toml")
