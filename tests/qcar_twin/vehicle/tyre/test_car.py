"""The tyre under the whole car: standstill, energy, circles, walls, threads, neighbours."""

import dataclasses

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.tyre import COLUMN
from qcar_twin.vehicle.vehicle import GRAVITY, WHEELS, Vehicle

CAR = Vehicle.load()
STEADY = dataclasses.replace(CAR, relaxation_length=0.0, longitudinal_relaxation=0.0)


def settled(vehicle: Vehicle = CAR, h: float = 0.002, **options) -> tuple[mujoco.MjModel, mujoco.MjData]:
  model = car_spec(vehicle, timestep=h, **options).compile()
  data = mujoco.MjData(model)
  mujoco.mj_step(model, data, round(0.5 / h))
  return model, data


def drive(model: mujoco.MjModel, data: mujoco.MjData, volt: float, steering: float, seconds: float) -> None:
  data.ctrl[:] = volt, steering
  mujoco.mj_step(model, data, round(seconds / model.opt.timestep))


def body_velocity(data: mujoco.MjData) -> np.ndarray:
  frame = np.empty(9)
  mujoco.mju_quat2Mat(frame, data.qpos[3:7])  # xmat is a step behind
  return frame.reshape(3, 3).T @ data.qvel[:3]


def energy(model: mujoco.MjModel, data: mujoco.MjData) -> float:
  """Mechanical energy of the car and of its tyres' carcasses, J."""
  mujoco.mj_fwdPosition(model, data)
  mujoco.mj_energyPos(model, data)
  mujoco.mj_energyVel(model, data)
  total = float(data.energy.sum())
  for k, wheel in enumerate(WHEELS):
    user, (load, *slip) = model.geom(wheel).user, data.plugin_state[3 * k : 3 * k + 3]
    stiffness = (
      user[[COLUMN["longitudinal_stiffness"], COLUMN["cornering_stiffness"]]] * load / user[COLUMN["nominal_load"]]
    )
    length = user[[COLUMN["longitudinal_relaxation"], COLUMN["relaxation_length"]]]
    total += float(0.5 * (length * stiffness) @ np.square(slip))
  return total


@pytest.mark.parametrize("speed", [0.3, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("h", [0.0005, 0.001, 0.002, 0.004])
def test_cornering_stiffness_of_the_car(speed, h):
  """A side force at the CG of a neutral car at constant speed: sideslip = F / (C_f + C_r)."""
  free = dataclasses.replace(CAR, motor_damping=1e-9, driveline_friction=0.0, load_exponent=0.0)
  model, data = settled(free, h)
  handles = Handles.of(model)
  data.qvel[0] = speed
  data.qvel[list(handles.spin_dofs)] = speed / CAR.wheel_radius
  data.qvel[handles.motor_dof] = speed / CAR.wheel_radius / CAR.gear_ratio
  force = 0.4
  data.xfrc_applied[handles.chassis, 1] = force
  mujoco.mj_step(model, data, round(0.35 / h))
  forward, left, _ = body_velocity(data)
  assert force / np.arctan2(left, forward) == pytest.approx(360.0, rel=0.02)


@pytest.mark.parametrize("direction", [0.0, np.pi / 4, np.pi / 2])
@pytest.mark.parametrize("vehicle", [CAR, STEADY], ids=["relaxation", "steady"])
def test_stands_on_a_slope_of_5_degrees(direction, vehicle):
  model, data = settled(vehicle)
  slope = np.radians(5.0)
  side = GRAVITY * np.sin(slope)
  model.opt.gravity[:] = side * np.cos(direction), side * np.sin(direction), -GRAVITY * np.cos(slope)
  drive(model, data, 0.0, 0.0, 1.0)
  before, velocity = data.qpos[:3].copy(), []
  for _ in range(500):
    mujoco.mj_step(model, data)
    velocity.append(data.qvel[:3].copy())
  assert np.linalg.norm(data.qpos[:3] - before) < 1e-4  # in one second
  assert np.ptp(velocity, axis=0).max() < 1e-6


@pytest.mark.parametrize("h", [0.0005, 0.002, 0.005])
def test_a_push_at_standstill_does_not_ring(h):
  model, data = settled(h=h)
  data.qvel[1] = 0.02
  speed = []
  for _ in range(round(0.4 / h)):
    mujoco.mj_step(model, data)
    speed.append(abs(data.qvel[1]))
  assert max(speed[round(0.1 / h) :]) < 0.1 * 0.02
  assert max(speed[round(0.3 / h) :]) < 0.002 * 0.02


@pytest.mark.parametrize("steering", [0.0, 0.15, -0.4])
@pytest.mark.parametrize("vehicle", [CAR, STEADY], ids=["relaxation", "steady"])
def test_coasting_never_gains_energy(vehicle, steering):
  model, data = settled(vehicle)
  drive(model, data, 2.5, steering, 2.0)
  drive(model, data, 0.0, steering, 0.1)
  track = [energy(model, data)]
  while data.time < 6.0:
    mujoco.mj_step(model, data)
    track.append(energy(model, data))
  assert np.diff(track).max() < 1e-6 * (track[0] - track[-1])
  assert np.linalg.norm(data.qvel) < 1e-3


@pytest.mark.parametrize("front, rear", [(180.0, 180.0), (140.0, 190.0), (200.0, 165.0)])
@pytest.mark.parametrize("volt", [0.9, 1.4])
def test_steady_circle_is_the_bicycles(front, rear, volt):
  """r = v delta / (L + K v^2), K = m / L (L_r / C_f - L_f / C_r): Rajamani 2012, 3.3, for axles of four tyres."""
  car = dataclasses.replace(
    CAR,
    cornering_stiffness_front=front,
    cornering_stiffness_rear=rear,
    load_exponent=0.0,
    cg_to_front=0.120,
    cg_to_rear=0.136,
  )
  steering = 0.04
  model, data = settled(car)
  drive(model, data, volt, steering, 4.0)
  speed, length = body_velocity(data)[0], car.wheelbase
  gradient = car.mass / length * (car.cg_to_rear / front - car.cg_to_front / rear)
  assert data.qvel[5] == pytest.approx(speed * steering / (length + gradient * speed**2), rel=0.02)


def test_steady_turn_does_not_depend_on_the_step():
  states = []
  for h in (0.0005, 0.002, 0.005):
    model, data = settled(h=h)
    drive(model, data, 2.0, 0.25, 3.0)
    states.append([*body_velocity(data)[:2], data.qvel[5], data.qvel[Handles.of(model).motor_dof] / 317.0])
  np.testing.assert_allclose(states[1:], np.broadcast_to(states[0], (2, 4)), atol=2e-3)


def test_wheel_speed_without_slip_is_the_cars():
  model, data = settled()
  drive(model, data, 1.5, 0.0, 3.0)
  handles = Handles.of(model)
  rolling = data.qvel[list(handles.spin_dofs)] * CAR.wheel_radius
  np.testing.assert_allclose(rolling, data.qvel[0], rtol=1e-3)
  assert data.qvel[handles.motor_dof] * CAR.gear_ratio == pytest.approx(rolling.mean() / CAR.wheel_radius, rel=1e-6)


def test_drives_into_a_wall_and_stops():
  spec = car_spec(CAR)
  spec.worldbody.add_geom(name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 1, 0.2], pos=[1.0, 0, 0.2])
  model = spec.compile()
  data = mujoco.MjData(model)
  drive(model, data, 2.0, 0.0, 3.0)
  assert 0.6 < data.qpos[0] < 0.95 and np.abs(data.qvel[:6]).max() < 0.05


def test_wheel_against_a_wall_keeps_its_tyre_on_the_floor():
  spec = car_spec(CAR)
  spec.geom("chassis").conaffinity = 0
  spec.worldbody.add_geom(name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 1, 0.2], pos=[0.5, 0, 0.2])
  model = spec.compile()
  data = mujoco.MjData(model)
  drive(model, data, 1.5, 0.0, 2.0)
  assert np.isfinite(data.qpos).all()
  assert data.qpos[0] + CAR.cg_to_front < 0.46
  loads = data.plugin_state[::3]
  assert loads.sum() == pytest.approx(CAR.mass * GRAVITY, rel=0.35)


def test_climbs_a_ramp():
  spec = car_spec(CAR)
  tilt = np.radians(12.0)
  spec.worldbody.add_geom(
    name="ramp", type=mujoco.mjtGeom.mjGEOM_BOX, size=[2, 1, 0.05], quat=[np.cos(tilt / 2), 0, -np.sin(tilt / 2), 0],
    pos=[0.4 + 2 * np.cos(tilt) + 0.05 * np.sin(tilt), 0, 2 * np.sin(tilt) - 0.05 * np.cos(tilt)],
  )  # fmt: skip
  model = spec.compile()
  data = mujoco.MjData(model)
  drive(model, data, 3.0, 0.0, 1.5)
  pitch = np.arcsin(data.body("chassis").xmat[6])  # nose up is positive
  assert pitch == pytest.approx(tilt, abs=0.03)
  assert data.qpos[2] > 0.15 and abs(data.qpos[1]) < 0.01 and body_velocity(data)[0] > 0.5


def test_thrown_car_lands_and_stands():
  model, data = settled()
  data.qpos[2] += 0.08
  data.qvel[:2] = 1.0, 0.5
  drive(model, data, 0.0, 0.0, 5.0)
  np.testing.assert_allclose(data.plugin_state[::3], CAR.static_load[0], rtol=1e-3)
  assert np.abs(data.qvel).max() < 1e-3


def batched(threads: int) -> tuple[np.ndarray, mujoco.MjModel, np.ndarray]:
  model = car_spec(CAR, timestep=0.004).compile()
  batch = Batch(model, 6, threads)
  user = batch.expand("geom_user")
  wheels = list(Handles.of(model).wheels)
  user[:, wheels, COLUMN["cornering_stiffness"]] *= np.linspace(0.7, 1.3, 6)[:, None]
  user[:, wheels, COLUMN["friction_coefficient"]] *= np.linspace(1.0, 0.5, 6)[:, None]
  batch.reset()
  batch.ctrl[:] = [2.0, 0.2]
  batch.step(nstep=300)
  return batch.state.copy(), model, user.copy()


def test_batch_is_the_same_on_one_and_two_threads_and_alone():
  one, model, user = batched(1)
  two, _, _ = batched(2)
  np.testing.assert_array_equal(one, two)
  assert np.ptp(one[:, 1 : 1 + model.nq], axis=0).max() > 0.01
  for row in (0, 5):
    model.geom_user[:] = user[row]
    data = mujoco.MjData(model)
    data.ctrl[:] = 2.0, 0.2
    mujoco.mj_step(model, data, 300)
    np.testing.assert_array_equal(data.qpos, one[row, 1 : 1 + model.nq])


def test_two_cars_in_one_model_drive_like_one():
  world = car_spec(CAR)
  other = car_spec(CAR)
  other.delete(other.geom("floor"))
  world.attach(other, prefix="b_", frame=world.worldbody.add_frame(pos=[0, 2, 0]))
  both, alone = world.compile(), car_spec(CAR).compile()
  a, b = mujoco.MjData(both), mujoco.MjData(alone)
  first, second = Handles.of(both), Handles.of(both, "b_")
  a.ctrl[[first.motor, second.motor]] = 2.0, 1.0
  a.ctrl[[first.steering, second.steering]] = 0.2, -0.1
  b.ctrl[:] = 2.0, 0.2
  mujoco.mj_step(both, a, 600)
  mujoco.mj_step(alone, b, 600)
  assert both.plugin_statenum.tolist() == [12, 12]
  np.testing.assert_allclose(a.qpos[:3], b.qpos[:3], atol=1e-6)
  assert a.qpos[alone.nq + 1] < 2.0  # the other one turned right


FOREIGN = """
<mujoco><size nuser_geom="9"/><option cone="elliptic"/>
  <worldbody><geom type="plane" size="5 5 1"/>
    <body pos="0 0 0.2"><freejoint/><geom type="ellipsoid" size="0.1 0.05 0.1" user="1 90 90 1 1 0 6 0 0"/></body>
  </worldbody></mujoco>"""


def test_foreign_models_and_other_cars_in_the_process_are_left_alone():
  foreign = mujoco.MjModel.from_xml_string(FOREIGN)

  def thrown() -> mujoco.MjData:
    data = mujoco.MjData(foreign)
    data.qvel[:] = 1, 0.3, 0, 0, 2, 1
    return data

  alone, beside = thrown(), thrown()
  mujoco.mj_step(foreign, alone, 400)
  cars = [settled(), settled()]
  for _ in range(400):
    mujoco.mj_step(foreign, beside)
    for k, (model, data) in enumerate(cars):
      drive(model, data, 1.0 + k, 0.1, model.opt.timestep)
  np.testing.assert_array_equal(alone.qpos, beside.qpos)
  model, data = settled()
  drive(model, data, 1.0, 0.1, 400 * model.opt.timestep)
  np.testing.assert_array_equal(data.qpos, cars[0][1].qpos)


def test_a_copy_of_the_data_goes_on_like_the_original():
  model, data = settled()
  drive(model, data, 2.0, 0.2, 0.5)
  other = mujoco.MjData(model)
  mujoco.mj_copyData(other, model, data)
  mujoco.mj_step(model, data, 50)
  mujoco.mj_step(model, other, 50)
  np.testing.assert_array_equal(data.qpos, other.qpos)


def test_mirrored_commands_give_mirrored_motion():
  tracks = []
  for sign in (1.0, -1.0):
    model, data = settled()
    drive(model, data, 2.0, sign * 0.2, 1.0)
    tracks.append(data.qpos[:2] * [1.0, sign])
  np.testing.assert_allclose(tracks[0], tracks[1], atol=1e-9)
