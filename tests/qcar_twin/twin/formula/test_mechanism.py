"""A formula in the twin: it pushes as it says, nothing at rest, never without bound, and it is kept in files."""

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS, Segments, signal_index
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.formula import Law
from qcar_twin.twin.formula.mechanism import made
from qcar_twin.twin.formula.written import described, from_described, write_mechanism
from qcar_twin.twin.mechanisms import add_file, catalogue, select
from qcar_twin.untrusted import UnreadableFile
from tests.qcar_twin.twin.formula.formulas import of_one_term, parameter, tabled, twin_with, yaw_drag


def driven(twin, theta, commands, speed=0.0):
  """Signals (T + 1, 10) of one stretch under commands (T, 2)."""
  start = np.array([[0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0]])
  segments = Segments(commands[None], start, np.array([len(commands)]), 0.01, ("run",), np.zeros(1))
  return twin.rollout(theta[None], segments).signals[0, 0]


def held(seconds: float, volts: float, angle: float):
  return np.tile([volts, angle], (int(100 * seconds), 1))


def test_at_its_null_it_changes_no_bit():
  twin, theta = twin_with(yaw_drag())
  bare = twin.with_mechanisms([])
  commands = held(2.0, 2.0, 0.2)
  assert np.array_equal(driven(twin, theta, commands), driven(bare, bare.parameters.nominal, commands))


def test_a_resistance_slows_the_car_where_it_turns_and_not_where_it_does_not():
  twin, theta = twin_with(yaw_drag(), unnamed_force_x_1=-1.2)
  bare = twin.parameters.nominal
  speed = lambda t, angle: driven(twin, t, held(3.0, 2.0, angle))[-1, signal_index("velocity_x")]
  assert speed(theta, 0.3) < 0.97 * speed(bare, 0.3)
  assert speed(theta, 0.0) == pytest.approx(speed(bare, 0.0), rel=1e-3)


def test_nothing_pushes_a_car_at_rest():
  twin, theta = twin_with(of_one_term("force_x", "cos(heading)"), found_1=9.0)
  assert np.abs(driven(twin, theta, held(3.0, 0.0, 0.0))[:, signal_index("velocity_x")]).max() < 1e-6


@pytest.mark.parametrize(
  ("degree", "term"),
  [("force_x", "speed"), ("force_x", "abs(accel_y)"), ("moment_z", "yaw_rate"), ("motor_torque", "square(yaw_rate)"),
   ("steering_angle", "accel_y"), ("force_y", "slip_power_3s * accel_y")],
)  # fmt: skip
def test_ten_minutes_with_a_formula_that_drives_the_car_stay_finite(degree: str, term: str):
  limit = {"moment_z": 0.2, "motor_torque": 0.02, "steering_angle": 0.2}.get(degree, 4.0)
  twin, theta = twin_with(of_one_term(degree, term, limit), found_1=9.0)
  wave = np.sin(0.7 * np.arange(60_000) / 100.0)
  signals = driven(twin, theta, np.column_stack([1.5 + wave, 0.3 * wave]))
  assert signals.shape == (60_001, len(SIGNALS))
  assert np.isfinite(signals).all()
  assert np.abs(signals[:, signal_index("velocity_x")]).max() < 40.0


def test_a_sensor_reads_what_the_formula_says():
  twin, theta = twin_with(of_one_term("reads_yaw_rate", "square(accel_y)"), found_1=0.01)
  commands = held(2.0, 2.0, 0.3)
  off = driven(twin, theta, commands) - driven(twin, twin.parameters.nominal, commands)
  across = driven(twin, theta, commands)[:, signal_index("accel_y")]
  assert np.allclose(off[:, signal_index("yaw_rate")], 0.01 * across**2)
  assert np.abs(np.delete(off, signal_index("yaw_rate"), axis=1)).max() == 0.0


def test_a_spot_pushes_near_it_alone():
  law = Law("force_x", ("sign(speed)",), {"speed": (0.0, 3.0), "place_x": (0.0, 9.0), "place_y": (-1.0, 1.0)}, 9.0,
            (2.0, 0.0, 0.3))  # fmt: skip
  spot = [parameter("found_1"), *(parameter(f"found_{n}", "m") for n in ("x", "y", "radius"))]
  twin, theta = twin_with(made("found", law, spot), found_1=-3.0, found_x=2.0, found_y=0.0, found_radius=0.3)
  pushed, free = (driven(twin, t, held(3.0, 2.0, 0.0), speed=1.5) for t in (theta, twin.parameters.nominal))
  apart = np.interp(free[:, 0], pushed[:, 0], pushed[:, 3]) - free[:, 3]  # of the speeds at the same places
  assert np.abs(apart[free[:, 0] < 0.8]).max() < 0.02
  assert apart[np.abs(free[:, 0] - 2.3) < 0.1].mean() < -0.1


@pytest.mark.parametrize("make", [yaw_drag, tabled])
def test_a_twin_file_brings_its_formula_as_data(make, tmp_path):
  twin, theta = twin_with(make(), unnamed_force_x_1=-1.25)
  save_twin(tmp_path / "twin.toml", twin, theta)
  loaded, values = load_twin(tmp_path / "twin.toml", threads=1)
  assert np.array_equal(values, theta)
  assert loaded.mechanisms[0].law == make().law
  assert "unnamed_force_x" not in catalogue()


def test_a_twin_file_with_a_term_nobody_knows_is_refused(tmp_path):
  twin, theta = twin_with(yaw_drag(), unnamed_force_x_1=-1.25)
  text = save_twin(tmp_path / "twin.toml", twin, theta).read_text().replace("abs(yaw_rate)", "exec(yaw_rate)")
  (tmp_path / "twin.toml").write_text(text)
  with pytest.raises(UnreadableFile, match=r"twin\.toml.*no operation 'exec'"):
    load_twin(tmp_path / "twin.toml")


def test_plain_data_gives_the_same_formula():
  for make in (yaw_drag, tabled):
    again = from_described("unnamed_force_x", described(make()))
    assert again.law == make().law and again.parameters == make().parameters


def test_a_mechanism_file_can_be_read_changed_and_run(tmp_path):
  mechanism = yaw_drag()
  name = 'a "set" \\ of \n logs'
  file = write_mechanism(tmp_path / "unnamed_force_x.py", mechanism, [(mechanism.parameters[0], -1.2, 0.04)], name)
  text = file.read_text()
  assert "F_x = c_1 |r| sgn(v)" in text and "not beyond" in text and "fitted: -1.2 +- 0.04 N s/rad" in text
  changed = tmp_path / "my_drag.py"
  changed.write_text(text.replace("unnamed_force_x", "my_drag").replace("abs(yaw_rate)", "square(yaw_rate)"))
  assert add_file(changed) == ("my_drag",)
  (mine,) = select(["my_drag"])
  twin, theta = twin_with(mine, my_drag_1=-0.5)
  slow, fast = (driven(twin, t, held(2.0, 2.0, 0.3))[-1, 3] for t in (theta, twin.parameters.nominal))
  assert slow < fast


def test_a_law_with_other_numbers_of_parameters_is_refused():
  with pytest.raises(ValueError, match="2 parameters for 1 numbers"):
    made("found", yaw_drag().law, [parameter("found_1"), parameter("found_2")])
