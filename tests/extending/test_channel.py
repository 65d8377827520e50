"""docs/guide/extending_channel.md does what it says: its files are written to a folder of their own and run."""

import functools
import json
import re
import runpy
import sys

import numpy as np
import pytest

from calibration.fitting.observations import CHANNELS, UNITS
from calibration.fitting.residual_channels import RESIDUALS, ResidualChannel, register
from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle
from qcar_twin.plant import START, Segments, signal_index
from qcar_twin.recordings import formats
from qcar_twin.recordings.channels import CHANNELS as RECORDED
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.sensors.onboard import ModelledSensor
from qcar_twin.sensors.suite import SensorSuite
from qcar_twin.vehicle.vehicle import Vehicle
from tests import ROOT

NAME = "front_left_wheel"
OWN_FILES = {"front_left_wheel_channel.py", "front_left_wheel_model.py"}
VEHICLE = Vehicle()
NUMBERS = {
  name: getattr(VEHICLE, name)
  for name in (
    "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius", "gear_ratio",
    "max_steering",
  )
}  # fmt: skip


def page():
  """File name -> text of every file that the page holds."""
  text = (ROOT / "docs" / "guide" / "extending_channel.md").read_text(encoding="utf-8")
  blocks = re.findall(r"```python\n(# (\S+\.py)\n.*?)```", text, re.DOTALL)
  return {name: block for block, name in blocks}


@pytest.fixture
def folder(tmp_path, monkeypatch):
  """A folder with the page's files, to run in; what they register is forgotten afterwards."""
  before = dict(RECORDED), dict(RESIDUALS), list(formats.__path__)
  for name, text in page().items():
    (tmp_path / name).write_text(text, encoding="utf-8")
  monkeypatch.chdir(tmp_path)
  monkeypatch.syspath_prepend(str(tmp_path))
  yield tmp_path
  for table, content in zip((RECORDED, RESIDUALS), before, strict=False):
    table.clear()
    table.update(content)
  formats.__path__[:] = before[2]
  for module in [name for name in sys.modules if name.rsplit(".", 1)[-1] + ".py" in page()]:
    del sys.modules[module]


@functools.cache
def driven(seconds=4.0, period=0.01):
  """Commands (T, 2) and signals (T, 10) of a winding drive by the bicycle model."""
  time = period * np.arange(int(seconds / period))
  commands = np.stack([1.5 + 0.5 * np.sin(0.8 * time), 0.25 * np.sin(1.3 * time)], axis=-1)
  stretch = Segments(commands[None], np.zeros((1, len(START))), np.array([len(time)]), period, ("run",), np.zeros(1))
  return time, commands, Bicycle(VEHICLE).rollout(PARAMETERS.nominal, stretch).signals[0, 0, :-1]


def measured(folder, scale=1.0, seed=0):
  """A data set whose one run holds the new channel, measured by a simulated sensor made of its record and its model."""
  import front_left_wheel_channel
  import front_left_wheel_model

  time, commands, signals = driven()
  sensor = ModelledSensor(front_left_wheel_channel.FRONT_LEFT_WHEEL, front_left_wheel_model.wheel_speed, VEHICLE)
  suite = SensorSuite({"wheel": sensor}, count=1, seed=seed)
  wheel = np.array([suite.measure(row[None])[0].values[0, 0] for row in signals])
  columns = dict(zip(("motor_voltage", "steering_command"), commands.T, strict=True))
  columns |= {name: signals[:, signal_index(name)] for name in ("motor_speed", "yaw_rate")}
  columns[NAME] = scale * wheel
  write_dataset(folder / "session", "wheels", NUMBERS, {}, [Recording.from_columns("run", time, columns)])
  return signals


def test_a_sensor_takes_two_files():
  registering = {name for name, text in page().items() if "register(" in text}
  assert registering == OWN_FILES


def test_the_new_channel_is_read_from_a_file_observed_and_enters_the_residual(folder):
  measured(folder)
  page = runpy.run_path(str(folder / "use.py"))
  data, observations, rows = page["data"], page["observations"], page["rows"]
  assert not data.warnings
  assert len(data["run"][NAME]) == 400 and rows.sum() > 350
  assert page["noise"].std == pytest.approx(RECORDED[NAME].noise, rel=0.2)
  assert NAME in observations.present and UNITS[NAME] == "rad/s" and CHANNELS[-1] == NAME
  prediction = Bicycle(VEHICLE).rollout(PARAMETERS.nominal, observations.stretches.segments)
  residual = observations.predict(prediction)[0] - observations.measured
  rolling = observations.measured[rows].std()
  assert np.std(residual[rows]) < 0.05 * rolling
  wide = PARAMETERS.vector({"drive_gain": 1.2 * PARAMETERS.nominal[PARAMETERS.index("drive_gain")]})
  faster = observations.predict(Bicycle(VEHICLE).rollout(wide, observations.stretches.segments))[0]
  assert np.std((faster - observations.measured)[rows]) > 2.0 * np.std(residual[rows])


def test_the_model_is_that_of_a_rolling_wheel(folder):
  """On a circle of radius R about a point on the rear axle's line, each wheel turns with its own distance from it."""
  import front_left_wheel_model

  radius, rate = 1.0, 0.9
  base, track = VEHICLE.cg_to_front + VEHICLE.cg_to_rear, VEHICLE.track_width
  signals = {"velocity_x": radius * rate, "velocity_y": rate * VEHICLE.cg_to_rear, "yaw_rate": rate}
  signals["steering_angle"] = np.arctan(base / (radius - track / 2))
  speed = front_left_wheel_model.wheel_speed(signals.__getitem__, VEHICLE) * VEHICLE.wheel_radius
  assert speed == pytest.approx(rate * np.hypot(radius - track / 2, base))


def test_a_log_of_it_in_another_unit_is_refused_with_the_cure(folder):
  measured(folder, scale=100.0)
  with pytest.raises(RecordingError, match=r"front_left_wheel reaches .* rad/s.*is it in rpm\? set scale = 0.10472 on"):
    DataSet.load(folder / "session")


def test_a_model_without_its_record_says_what_to_do_first(folder):
  with pytest.raises(ValueError, match="registered in qcar_twin.recordings.channels first"):
    ResidualChannel("front_left", "rad/s", "front left wheel", (NAME,), lambda signal, car: signal("motor_speed"))
  with pytest.raises(ValueError, match="one of a model, a displacement, a path and a way"):
    ResidualChannel("front_left", "rad/s", "front left wheel", ("speed",))
  with pytest.raises(ValueError, match="there is a residual channel 'speed' already"):
    register(ResidualChannel.recorded("speed"))


def test_a_format_takes_one_file(folder):
  time, commands, signals = driven()
  names = ("time", "motor_voltage", "steering_command", "motor_speed", "yaw_rate")
  table = np.column_stack([time, commands, signals[:, [signal_index(name) for name in names[3:]]]])
  (folder / "run.steps").write_text(
    "\n".join(json.dumps(dict(zip(names, row.tolist(), strict=True))) for row in table), encoding="utf-8"
  )
  with pytest.raises(RecordingError, match="cannot read '.steps' files; readable are: .csv"):
    formats.read_table(folder / "run.steps")
  formats.__path__.append(str(folder))
  read = formats.read_table(folder / "run.steps").columns
  assert all((read[name] == table[:, column]).all() for column, name in enumerate(names))
  (folder / "run.steps").write_text('{"time": 0.0}\n{"speed": 1.0}\n', encoding="utf-8")
  with pytest.raises(RecordingError, match="run.steps: its lines have different keys"):
    formats.read_table(folder / "run.steps")
