"""The car's numbers, and that the model has them: masses, loads, inertia, drive, steering."""

import dataclasses
import logging
import math
import tomllib

import mujoco
import numpy as np
import pytest

from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import car_model, car_spec, knuckle_inertia, servo_force
from qcar_twin.vehicle.vehicle import ASSETS, GRAVITY, WHEELS, Vehicle

CAR = Vehicle.load()
DART = {
  "name": "dart", "mass": 1.58, "yaw_inertia": 0.0048, "cg_to_front": 0.0805, "cg_to_rear": 0.093, "track_width": 0.16,
  "cg_height": 0.04, "wheel_radius": 0.033, "gear_ratio": 0.1, "max_steering": 0.45,
}  # fmt: skip
MICRO = {
  "name": "micro", "mass": 0.5, "yaw_inertia": 0.0017, "cg_to_front": 0.075, "cg_to_rear": 0.075, "track_width": 0.095,
  "cg_height": 0.025, "wheel_radius": 0.018, "gear_ratio": 0.1, "max_steering": 0.5,
}  # fmt: skip
CARS = [CAR, Vehicle.from_dataset(DART), Vehicle.from_dataset(MICRO)]


def standing(car: Vehicle, seconds: float = 1.0, **options) -> tuple[mujoco.MjModel, mujoco.MjData, Handles]:
  model = car_spec(car, **options).compile()
  data = mujoco.MjData(model)
  mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
  return model, data, Handles.of(model)


def wheel_loads(model: mujoco.MjModel, data: mujoco.MjData, handles: Handles) -> np.ndarray:
  """Normal force under every wheel, N, (4,)."""
  loads, force = np.zeros(4), np.zeros(6)
  for k in range(data.ncon):
    mujoco.mj_contactForce(model, data, k, force)
    loads[handles.wheels.index(int(data.contact[k].geom[1]))] += force[0]
  return loads


@pytest.mark.parametrize("tyre", ["contact", "native"])
@pytest.mark.parametrize("car", CARS, ids=lambda c: c.name)
def test_stands_at_its_height_with_its_loads(car, tyre):
  model, data, handles = standing(car, tyre=tyre)
  front, rear = car.static_load
  np.testing.assert_allclose(wheel_loads(model, data, handles), [front, front, rear, rear], rtol=1e-3)
  assert data.qpos[2] == pytest.approx(car.cg_height, abs=1e-3 if tyre == "native" else 4e-4)
  assert np.abs(data.qvel).max() < 1e-6
  assert 2 * (front + rear) == pytest.approx(car.mass * GRAVITY)


@pytest.mark.parametrize("h", [0.0005, 0.002, 0.005])
@pytest.mark.parametrize("car", CARS, ids=lambda c: c.name)
def test_starts_at_rest(car, h):
  model = car_spec(car, timestep=h).compile()
  data = mujoco.MjData(model)
  fastest = 0.0
  for _ in range(round(0.1 / h)):
    mujoco.mj_step(model, data)
    fastest = max(fastest, np.abs(data.qvel[:6]).max())
  assert fastest < 1e-3


@pytest.mark.parametrize("car", CARS, ids=lambda c: c.name)
def test_mass_centre_of_gravity_and_yaw_inertia(car):
  model = car_spec(car).compile()
  data = mujoco.MjData(model)
  mujoco.mj_forward(model, data)
  full = np.zeros((model.nv, model.nv))
  mujoco.mj_fullM(model, data, full)
  assert full[0, 0] == pytest.approx(car.mass, rel=1e-9)
  assert full[5, 5] == pytest.approx(car.yaw_inertia, rel=1e-5)
  np.testing.assert_allclose(data.subtree_com[1], data.qpos[:3], atol=1e-9)


@pytest.mark.parametrize("car", CARS, ids=lambda c: c.name)
def test_steady_speed_follows_from_the_drive(car):
  """(K/R) V = (K^2/R) w + T_c, and the wheels turn at gear_ratio w."""
  model, data, handles = standing(car)
  volt = 2.0
  data.ctrl[handles.motor] = volt
  mujoco.mj_step(model, data, 4000)
  expected = (car.torque_per_volt * volt - car.driveline_friction) / car.motor_damping
  assert data.qvel[handles.motor_dof] == pytest.approx(expected, rel=2e-3)
  assert data.qvel[0] == pytest.approx(expected * car.gear_ratio * car.wheel_radius, rel=4e-3)
  assert data.sensordata[handles.encoder] == pytest.approx(expected, rel=2e-3)


def test_speed_rises_with_the_inertia_of_the_whole_car():
  car = dataclasses.replace(CAR, driveline_friction=0.0, longitudinal_stiffness=5e4, relaxation_length=0.0)
  car = dataclasses.replace(car, longitudinal_relaxation=0.0)
  model, data, handles = standing(car, timestep=0.0005)
  data.ctrl[handles.motor] = 1.0
  time_constant = car.drive_inertia / car.motor_damping
  mujoco.mj_step(model, data, round(time_constant / 0.0005))
  final = car.torque_per_volt / car.motor_damping
  assert data.qvel[handles.motor_dof] == pytest.approx(final * (1 - math.exp(-1)), rel=0.01)


def test_motor_friction_holds_the_car_until_the_voltage_beats_it():
  model, data, handles = standing(CAR)
  breakaway = CAR.driveline_friction / CAR.torque_per_volt
  for share, moves in ((0.95, False), (1.1, True)):
    data.ctrl[handles.motor] = share * breakaway
    mujoco.mj_step(model, data, 500)
    assert (data.qvel[0] > 0.01) == moves


@pytest.mark.parametrize("h", [0.001, 0.002, 0.005])
def test_servo_is_first_order_at_any_step(h):
  car = dataclasses.replace(CAR, servo_time_constant=0.02, ackermann_fraction=0.0)
  model, data, handles = standing(car, timestep=h)
  data.ctrl[handles.steering] = 0.3
  track = []
  for _ in range(round(0.1 / h)):
    mujoco.mj_step(model, data)
    track.append(data.qpos[list(handles.steering_qpos)].mean())
  time = h * np.arange(1, len(track) + 1)
  np.testing.assert_allclose(track, 0.3 * (1 - np.exp(-time / 0.02)), atol=2e-3)


def test_servo_rate_and_lock():
  car = dataclasses.replace(CAR, servo_rate=4.0, servo_time_constant=0.002)
  model, data, handles = standing(car)
  data.ctrl[handles.steering] = 2.0
  mujoco.mj_step(model, data, 50)
  angle = data.qpos[list(handles.steering_qpos)].mean()
  assert angle == pytest.approx(0.4, abs=0.02)
  assert model.actuator("steering").forcerange[1] == pytest.approx(servo_force(4.0, knuckle_inertia(car), 0.002))
  mujoco.mj_step(model, data, 200)
  assert data.qpos[list(handles.steering_qpos)].mean() == pytest.approx(car.max_steering, abs=1e-3)


@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0, -0.3])
@pytest.mark.parametrize("angle", [0.15, -0.3])
def test_ackermann_splits_the_road_wheels(fraction, angle):
  """Fraction 1 aims both wheels at one centre on the rear axle: cot(outer) - cot(inner) = track / wheelbase."""
  model, data, handles = standing(dataclasses.replace(CAR, ackermann_fraction=fraction))
  data.ctrl[handles.steering] = angle
  mujoco.mj_step(model, data, 300)
  left, right = data.qpos[list(handles.steering_qpos)]
  assert (left + right) / 2 == pytest.approx(angle, abs=1e-4)
  share = (1 / math.tan(right) - 1 / math.tan(left)) / (CAR.track_width / CAR.wheelbase)
  assert share == pytest.approx(fraction, abs=0.05)


def test_ackermann_is_one_number_of_the_equality():
  model, data, handles = standing(CAR)
  model.equality("ackermann").data[2] = 0.0
  data.ctrl[handles.steering] = 0.3
  mujoco.mj_step(model, data, 300)
  left, right = data.qpos[list(handles.steering_qpos)]
  assert left == pytest.approx(right, abs=1e-5)


def test_differentials_are_open_and_the_centre_is_rigid():
  model, data, handles = standing(CAR)
  data.ctrl[:] = 0.8, 0.4
  mujoco.mj_step(model, data, 2000)
  spin = data.qvel[list(handles.spin_dofs)]
  assert spin[1] - spin[0] > 2.0 and spin[3] - spin[2] > 2.0
  for axle in (spin[:2], spin[2:]):
    assert axle.mean() == pytest.approx(CAR.gear_ratio * data.qvel[handles.motor_dof], rel=1e-4)


def test_rolling_resistance_slows_like_a_force():
  deceleration = []
  for coefficient in (0.0, 0.02):
    car = dataclasses.replace(CAR, rolling_resistance=coefficient, motor_damping=1e-9, driveline_friction=0.0)
    model, data, handles = standing(car)
    data.qvel[0] = 1.5
    data.qvel[list(handles.spin_dofs)] = 1.5 / car.wheel_radius
    data.qvel[handles.motor_dof] = 1.5 / car.wheel_radius / car.gear_ratio
    mujoco.mj_step(model, data, 100)
    before = data.qvel[0]
    mujoco.mj_step(model, data, 250)
    deceleration.append((before - data.qvel[0]) / 0.5)
  moving = CAR.drive_inertia / (CAR.gear_ratio * CAR.wheel_radius) ** 2
  assert deceleration[0] < 1e-3
  assert deceleration[1] == pytest.approx(0.02 * CAR.mass * GRAVITY / moving, rel=0.02)


def test_imu_feels_its_lever_arm():
  car = dataclasses.replace(CAR, imu_x=0.08, imu_y=-0.03)
  model, data, handles = standing(car)
  assert data.sensordata[handles.accelerometer : handles.accelerometer + 3] == pytest.approx([0, 0, GRAVITY], abs=1e-3)
  data.ctrl[:] = 1.5, 0.3
  mujoco.mj_step(model, data, 1500)
  rate = data.sensordata[handles.gyro + 2]
  at_imu = data.sensordata[handles.accelerometer : handles.accelerometer + 2].copy()
  model.site("imu").pos[:2] = 0.0
  mujoco.mj_forward(model, data)
  at_cg = data.sensordata[handles.accelerometer : handles.accelerometer + 2]
  np.testing.assert_allclose(at_imu - at_cg, [-(rate**2) * 0.08, rate**2 * 0.03], atol=0.02)


def test_everything_is_named_and_looks_do_not_touch_the_physics():
  bare, full = car_spec(CAR).compile(), car_spec(CAR, looks=True).compile()
  for kind in ("body", "jnt", "geom", "site", "cam", "actuator", "sensor", "tendon", "eq"):
    count = getattr(full, {"jnt": "njnt", "cam": "ncam", "actuator": "nu", "eq": "neq"}.get(kind, f"n{kind}"))
    names = [full.names[adr:].split(b"\0")[0] for adr in getattr(full, f"name_{kind}adr")]
    assert len(names) == count and all(names), kind
  assert bare.ncam == 0 and {full.camera(k).name for k in range(full.ncam)} == {"chase", "top", "onboard"}
  visible = full.geom_group == 2
  assert visible.sum() > 20 and not (full.geom_contype | full.geom_conaffinity)[visible].any()
  np.testing.assert_array_equal(bare.body_mass, full.body_mass)
  states = []
  for model in (bare, full):
    data = mujoco.MjData(model)
    data.ctrl[:] = 2.0, 0.2
    mujoco.mj_step(model, data, 300)
    states.append(data.qpos.copy())
  np.testing.assert_array_equal(*states)


def test_only_wheels_and_hull_collide_and_only_with_the_world():
  model = car_spec(CAR, looks=True).compile()
  colliding = [model.geom(g).name for g in range(model.ngeom) if model.geom_conaffinity[g]]
  assert set(colliding) == {*WHEELS, "chassis"}
  assert not model.geom_contype[[model.geom(name).id for name in colliding]].any()


def test_toml_has_a_source_for_every_number_and_agrees_with_the_defaults():
  table = tomllib.loads((ASSETS / "qcar.toml").read_text())
  entries = {key: value for key, value in table.items() if isinstance(value, dict)}
  assert len(entries) > 15 and all({"value", "unit", "source"} <= set(entry) for entry in entries.values())
  default = Vehicle()
  for key, entry in entries.items():
    assert getattr(CAR, key) == entry["value"] == pytest.approx(getattr(default, key), rel=1e-6)
  assert CAR.std["mass"] == entries["mass"]["std"]


def test_another_car_keeps_what_scales():
  for car in CARS[1:]:
    assert car.cornering_stiffness_front / car.static_load[0] == pytest.approx(180 / CAR.static_load[0])
    rolling = car.gear_ratio * car.wheel_radius
    assert car.torque_per_volt / car.drive_inertia * rolling == pytest.approx(
      CAR.torque_per_volt / CAR.drive_inertia * CAR.gear_ratio * CAR.wheel_radius, rel=0.05
    )


def test_a_small_yaw_inertia_makes_lighter_wheels():
  car = Vehicle.from_dataset(MICRO | {"yaw_inertia": 0.0004})
  assert car.chassis_yaw_inertia > 0.0 and car.wheel_mass < Vehicle.from_dataset(MICRO).wheel_mass
  car_spec(car).compile()


@pytest.mark.parametrize(
  "change, text",
  [
    ({"mass": 0.0}, "mass must be a positive number"),
    ({"wheel_radius": -0.03}, "wheel_radius must be a positive number"),
    ({"yaw_inertia": 1e-4}, "correct yaw_inertia, or give a smaller wheel_mass"),
    ({"std": {"mass": 0.0}}, "the std of mass must be a positive number"),  # it would pass for no prior at all
    ({"std": {"mass": -0.05}}, "the std of mass must be a positive number"),
    ({"std": {"mass": np.inf}}, "the std of mass must be a positive number"),
  ],
)
def test_impossible_numbers_are_refused(change, text):
  with pytest.raises(ValueError, match=text):
    dataclasses.replace(CAR, **change)


def test_unknown_names_are_said(tmp_path, caplog):
  path = tmp_path / "car.toml"
  path.write_text('mas = { value = 2.0, unit = "kg", source = "scale" }\n')
  with pytest.raises(ValueError, match=r"car.toml: a vehicle has no 'mas'; did you mean mass"):
    Vehicle.load(path)
  path.write_text("mass = 2.0\n")
  with pytest.raises(ValueError, match="'mass' must be a table with value, unit and source"):
    Vehicle.load(path)
  with caplog.at_level(logging.WARNING):
    Vehicle.from_dataset(DART | {"trak_width": 0.1})
  assert "did you mean 'track_width'?" in caplog.text
  with pytest.raises(ValueError, match="'contact' or 'native', not 'magic'"):
    car_spec(CAR, tyre="magic")


def test_motor_bench_figures_become_the_drive():
  car = Vehicle.from_dataset(DART | {"motor_constant": 0.003, "motor_resistance": 0.1})
  assert car.torque_per_volt == pytest.approx(0.03) and car.motor_damping == pytest.approx(9e-5)
  assert 0 < car.std["torque_per_volt"] < 0.3 * car.torque_per_volt


def test_bodies_that_cannot_be_are_said_in_one_line():
  with pytest.raises(ValueError, match=r"vehicle '.*' can't be built: .*; correct its masses") as refused:
    car_model(dataclasses.replace(CAR, wheel_mass=1e-20, wheel_inertia=1e-25))
  assert "\n" not in str(refused.value)


def test_an_integer_of_any_length_is_a_number():
  assert dataclasses.replace(CAR, max_torque=10**30).max_torque == 1e30
