"""Cars that are driven otherwise: axles and drive commands, from a TOML file to what the wheels feel."""

import dataclasses
import math

import numpy as np
import pytest

from calibration.fitting.windows import cut_recordings
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.plant import Segments
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.mechanisms import offered, select
from qcar_twin.twin.parameters import drive_response, drive_values
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import QCAR, Vehicle

F1TENTH = """
name = "f1tenth"
layout = "rear"
drive = "speed"
mass = { value = 3.5, unit = "kg", std = 0.01, source = "kitchen scale" }
yaw_inertia = { value = 0.047, unit = "kg m^2", source = "bifilar pendulum" }
cg_to_front = { value = 0.159, unit = "m", source = "two scales" }
cg_to_rear = { value = 0.171, unit = "m", source = "two scales" }
track_width = { value = 0.24, unit = "m", source = "ruler" }
cg_height = { value = 0.07, unit = "m", source = "tilt" }
wheel_radius = { value = 0.05, unit = "m", source = "ruler" }
gear_ratio = { value = 0.083, unit = "-", source = "teeth" }
max_steering = { value = 0.41, unit = "rad", source = "protractor" }
motor_constant = { value = 0.0027, unit = "N m/A", source = "3500 rpm/V" }
max_current = { value = 30.0, unit = "A", source = "VESC Tool" }
"""


@pytest.fixture
def f1tenth(tmp_path) -> Vehicle:
  (tmp_path / "f1tenth.toml").write_text(F1TENTH, encoding="utf-8")
  return Vehicle.load(tmp_path / "f1tenth.toml")


def car_of(drive: str, layout: str = "all-wheel", **numbers) -> Vehicle:
  """The QCar's size with another drive and without dry friction."""
  sizes = (
    "mass",
    "cg_to_front",
    "cg_to_rear",
    "track_width",
    "cg_height",
    "wheel_radius",
    "gear_ratio",
    "max_steering",
  )
  given = {name: getattr(QCAR, name) for name in sizes} | {"max_steering": 0.5, "driveline_friction": 1e-9} | numbers
  return Vehicle.from_dataset({"name": drive, "drive": drive, "layout": layout} | given)


def driven(twin: Twin, command: float, seconds: float, start: float = 0.0, steering: float = 0.0) -> np.ndarray:
  """Motor speed [rad/s] under a held command, (T + 1,)."""
  length = round(seconds / twin.period)
  commands = np.tile([command, steering], (1, length, 1))
  state = np.zeros((1, 7))
  state[0, 3], state[0, 6] = start, steering
  segments = Segments(commands, state, np.array([length]), twin.period, ("run",), np.zeros(1))
  return twin.rollout(twin.parameters.nominal, segments).channel("motor_speed")[0, 0]


def test_a_file_describes_the_car(f1tenth):
  assert (f1tenth.layout, f1tenth.drive, f1tenth.driven_axles) == ("rear", "speed", ("rear",))
  assert f1tenth.max_torque == pytest.approx(0.0027 * 30.0)
  assert f1tenth.commands == ("speed_command", "steering_command")
  usual = Vehicle.from_dataset({"drive": "speed", "mass": 3.5, "wheel_radius": 0.05})
  assert f1tenth.cornering_stiffness_front > QCAR.cornering_stiffness_front  # scaled, not the QCar's own
  assert math.isfinite(usual.max_torque) and math.isinf(Vehicle.from_dataset({}).max_torque)


@pytest.mark.parametrize(
  ("key", "value", "said"), [("layout", "4wd", "all-wheel, rear, front"), ("drive", "pwm", "duty")]
)
def test_an_unknown_layout_or_drive_is_refused_with_the_known_ones(key, value, said):
  with pytest.raises(ValueError, match=f"{key} must be one of.*{said}.*'{value}'"):
    Vehicle.from_dataset({key: value})


def test_a_twin_file_keeps_layout_and_drive(f1tenth, tmp_path):
  twin = Twin(f1tenth, substeps=2, threads=1)
  theta = twin.parameters.vector({"torque_per_speed": 1.1 * f1tenth.torque_per_speed})
  back, values = load_twin(save_twin(tmp_path / "twin.toml", twin, theta), substeps=2, threads=1)
  assert back.vehicle == f1tenth
  np.testing.assert_array_equal(values, theta)


@pytest.mark.parametrize(("drive", "command"), [("voltage", 2.0), ("duty", 0.2), ("speed", 1.2)])
def test_the_steady_speed_follows_from_the_law(drive, command):
  car = car_of(drive)
  twin = Twin(car, substeps=2, threads=1)
  steady = car.torque_per_command * command * car.command_scale / car.motor_damping
  assert driven(twin, command, 4.0)[-1] == pytest.approx(steady, rel=2e-3)
  if drive == "speed":
    assert steady * car.gear_ratio * car.wheel_radius == pytest.approx(command)


def test_a_current_is_a_torque():
  car = car_of("current", motor_damping=1e-9)
  twin = Twin(car, substeps=2, threads=1)
  speed = driven(twin, 3.0, 1.0)
  gained = (speed[-1] - speed[50]) / 0.5
  assert gained == pytest.approx(car.torque_per_ampere * 3.0 / car.drive_inertia, rel=0.02)


def test_the_torque_limit_bounds_the_acceleration():
  free, bound = (car_of("speed", max_torque=limit) for limit in (10.0, 0.01))
  speed = driven(Twin(bound, substeps=2, threads=1), 3.0, 0.3)
  assert (speed[30] - speed[10]) / 0.2 == pytest.approx(0.01 / bound.drive_inertia, rel=0.02)
  assert driven(Twin(free, substeps=2, threads=1), 3.0, 0.3)[30] > 1.5 * speed[30]


def test_the_torque_limit_is_a_parameter_of_each_car():
  twin = Twin(car_of("speed", max_torque=0.02), substeps=2, threads=1)
  theta = np.stack([twin.parameters.nominal, twin.parameters.vector({"max_torque": 0.01})])
  commands = np.tile([3.0, 0.0], (1, 20, 1))
  segments = Segments(commands, np.zeros((1, 7)), np.array([20]), twin.period, ("run",), np.zeros(1))
  both = twin.rollout(theta, segments).channel("motor_speed")[:, 0, -1]
  assert both[0] == pytest.approx(2.0 * both[1], rel=0.05)
  assert "max_torque" not in Twin(QCAR, threads=1).parameters


def test_a_duty_is_a_share_of_the_supply_voltage():
  volts, duty = (Twin(car_of(drive, supply_voltage=10.0), substeps=2, threads=1) for drive in ("voltage", "duty"))
  np.testing.assert_allclose(driven(duty, 0.25, 1.0), driven(volts, 2.5, 1.0), rtol=1e-12)


@pytest.mark.parametrize("layout", ["rear", "front"])
def test_wheels_that_are_not_driven_roll_free(layout):
  """In a turn the encoder sees the driven axle: the steered front wheels go a longer way, by 1 / cos(delta)."""
  model = car_spec(car_of("voltage", layout)).compile()
  free = "front" if layout == "rear" else "rear"
  names = {model.equality(k).name for k in range(model.neq)} | {model.tendon(k).name for k in range(model.ntendon)}
  assert f"{free}_axle" not in names and f"{free}_differential" not in names
  assert {f"{layout}_axle", f"{layout}_differential"} <= names
  twin = Twin(car_of("voltage", layout), substeps=2, threads=1)
  length = 300
  commands, start = np.tile([1.0, 0.4], (1, length, 1)), np.zeros((1, 7))
  segments = Segments(commands, start, np.array([length]), twin.period, ("turn",), np.zeros(1))
  rollout = twin.rollout(twin.parameters.nominal, segments)
  rolled = rollout.channel("motor_speed")[0, 0, -1] * QCAR.gear_ratio * QCAR.wheel_radius
  expected = 1.0 if layout == "rear" else 1.0 / math.cos(0.4)
  assert rolled / rollout.channel("velocity_x")[0, 0, -1] == pytest.approx(expected, rel=0.015)


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_what_a_drive_has_not_got_is_not_offered(drive):
  names = {mechanism.name for mechanism in offered(drive)}
  assert ("battery_sag" in names) == (drive in ("voltage", "duty"))
  assert {"steering_delay", "drive_delay", "quadratic_drag"} <= names
  if drive == "speed":
    with pytest.raises(ValueError, match="'battery_sag' is physics of a drive by voltage or duty; speed is driven by"):
      Twin(car_of("speed"), select(["battery_sag"]))


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_the_bicycles_numbers_and_the_twins_are_one_another(drive):
  car = car_of(drive, supply_voltage=10.0)
  base = Twin(car, substeps=2, threads=1).base
  values = drive_values(car, 300.0, 2.0, 5.0)
  moved = base.replace(**{n: dataclasses.replace(base[n], nominal=v, lower=0.0, upper=9.0) for n, v in values.items()})
  assert drive_response(car, moved) == pytest.approx((300.0, 2.0, 5.0))
  unit = Bicycle(car).parameters["drive_gain"].unit
  assert DRIVES[drive].unit in unit


def test_a_recording_of_another_drive_is_refused():
  time = np.arange(0.0, 1.0, 0.01)
  run = Recording.from_columns("run", time, {"motor_voltage": 0.0 * time, "motor_speed": 0.0 * time})
  with pytest.raises(ValueError, match=r'run.*motor_voltage.*speed_command.*drive = "speed".*dataset.toml'):
    cut_recordings([run], car_of("speed"))
