"""A brake beside the throttle."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from tests.qcar_twin.recordings.drives import write_csv


def drive(folder, throttle="gas_pct", brake="brake_pct", both=False):
  """Drives of 6 s under a throttle in per cent, each stopped by a brake, or by one that is pressed all the while."""
  time = np.arange(3000) / 50.0
  gas = np.where(time % 6.0 < 4.0, np.repeat(np.random.default_rng(2).uniform(20.0, 80.0, 10), 300), 0.0)
  pressed = np.where(gas > 0.0, 10.0 * both, 50.0)
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    pull = 0.01 * gas[k] - 0.04 - 0.2 * speed[k - 1] if gas[k] > 0.0 else -0.6
    speed[k] = max(speed[k - 1] + 0.2 * pull, 0.0)
  steer = 0.2 * np.sin(1.1 * time)
  turned = speed * np.tan(steer) / 0.256
  columns = {throttle: gas, brake: pressed, "steer [rad]": steer, "speed": speed, "gyro_z": turned}
  write_csv(folder / "run.csv", time, columns)
  return time, gas, pressed


def drafted(folder, wheelbase=0.256, mass=2.7):
  text = propose("lab", [read_table(folder / "run.csv")], wheelbase=wheelbase, mass=mass).text
  (folder / "dataset.toml").write_text(text, encoding="utf-8")
  return text


def test_a_brake_of_a_model_car_is_the_other_end_of_its_throttle(tmp_path):
  time, gas, pressed = drive(tmp_path)
  assert 'motor_duty = { column = "gas_pct", scale = 0.01, minus = "brake_pct" }' in drafted(tmp_path)
  runs = DataSet.load(tmp_path).recordings  # three roles of one file
  told = np.concatenate([run["motor_duty"].value for run in runs])
  np.testing.assert_allclose([told.min(), told.max()], [-0.5, 0.01 * gas.max()], atol=1e-9)
  for run in runs:
    inside = time[(time > run.start) & (time < run.end)]
    np.testing.assert_allclose(run["motor_duty"].at(inside), np.interp(inside, time, 0.01 * (gas - pressed)), atol=1e-9)


@pytest.mark.parametrize(
  "changed", [{"brake": "brake_bar"}, {"both": True}, {"throttle": "gas"}], ids=["unit", "both", "no unit"]
)
def test_a_brake_in_another_unit_or_pressed_with_the_throttle_is_told_and_left(tmp_path, changed):
  drive(tmp_path, **changed)
  text = drafted(tmp_path)
  assert "minus =" not in text.split("[channels]")[1].split("# columns")[0]
  assert "is pressed in" in text and "set minus = " in text


def test_a_large_car_brakes_at_its_wheels(tmp_path):
  drive(tmp_path)
  assert 'minus = "brake_pct" }' not in drafted(tmp_path, wheelbase=2.6, mass=1400.0)


def test_a_brake_that_was_never_logged_is_refused_by_its_name(tmp_path):
  drive(tmp_path)
  text = drafted(tmp_path).replace('minus = "brake_pct"', 'minus = "pedal"')
  (tmp_path / "dataset.toml").write_text(text, encoding="utf-8")
  with pytest.raises(Exception, match="pedal"):
    DataSet.load(tmp_path)
