"""The documented model fields: written per simulation they are the car rebuilt, and no value a fit tries breaks it."""

import dataclasses

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import CENTRE_SWITCH, car_spec, centre_damping, differential_rows, tyre_of
from qcar_twin.vehicle.vehicle import WHEELS, Vehicle

CAR = Vehicle.load()
SMALLER = {"mass": 1.58, "yaw_inertia": 0.0048, "cg_to_front": 0.0805, "cg_to_rear": 0.093, "track_width": 0.16}
SMALLEST = {"mass": 0.5, "yaw_inertia": 0.0017, "cg_to_front": 0.075, "cg_to_rear": 0.075, "track_width": 0.095}
CARS = [
  CAR,
  Vehicle.from_dataset(SMALLER | {"cg_height": 0.04}),
  Vehicle.from_dataset(SMALLEST | {"wheel_radius": 0.018}),
]
TYRE = ("cornering_stiffness_front", "friction_coefficient", "relaxation_length", "longitudinal_relaxation")


def _write_field(batch: Batch, name: str, car: Vehicle) -> None:
  """The documented place of a quantity in a batch's model fields."""
  model, handles = batch.model, Handles.of(batch.model)
  if name in ("torque_per_volt", "motor_damping"):
    constant = car.motor_damping / car.torque_per_volt
    batch.expand("actuator_gainprm")[:, model.actuator("motor").id, :2] = constant / car.torque_per_volt, constant
  elif name == "driveline_friction":
    batch.expand("dof_frictionloss")[:, handles.motor_dof] = car.driveline_friction
  elif name == "rotor_inertia":
    batch.expand("dof_armature")[:, handles.motor_dof] = car.rotor_inertia
  elif name == "servo_time_constant":
    batch.expand("actuator_dynprm")[:, model.actuator("steering").id, 0] = car.servo_time_constant
  elif name == "ackermann_fraction":
    batch.expand("eq_data")[:, model.equality("ackermann").id, 2] = (
      car.ackermann_fraction * car.track_width / (2 * car.wheelbase)
    )
  elif name == "centre_differential":
    row, weight = model.equality("centre").id, model.tendon_invweight0[model.tendon("centre").id]
    rows = differential_rows(centre_damping(car.centre_differential), model.opt.timestep, weight)
    batch.expand("eq_solref")[:, row], batch.expand("eq_solimp")[:, row] = rows
    for equality, active in CENTRE_SWITCH.items():
      batch.bind("eq_active")[:, model.equality(equality).id] = active
  elif name == "rolling_resistance":
    loads = np.repeat(car.static_load, 2)
    batch.expand("dof_frictionloss")[:, list(handles.spin_dofs)] = car.rolling_resistance * loads * car.wheel_radius
  if name in (*TYRE, "rotor_inertia"):
    batch.expand("geom_user")[:, list(handles.wheels)] = [tyre_of(car, wheel) for wheel in WHEELS]


@pytest.mark.parametrize(
  "name, value",
  [
    ("torque_per_volt", 0.035),
    ("motor_damping", 1e-4),
    ("driveline_friction", 4e-3),
    ("rotor_inertia", 6e-6),
    ("servo_time_constant", 0.03),
    ("ackermann_fraction", 0.2),
    ("rolling_resistance", 0.03),
    ("centre_differential", 0.7),
    ("cornering_stiffness_front", 120.0),
    ("friction_coefficient", 0.3),
    ("relaxation_length", 0.05),
    ("longitudinal_relaxation", 0.1),
  ],
)
def test_a_field_written_per_simulation_is_the_car_rebuilt(name, value):
  changed = dataclasses.replace(CAR, **{name: value})
  batch = Batch(car_spec(CAR).compile(), 1, 1)
  _write_field(batch, name, changed)
  batch.set_const()
  switched = batch.bind("eq_active").copy()
  ends = []
  for model in (car_spec(changed).compile(), car_spec(CAR).compile()):
    data = mujoco.MjData(model)
    data.ctrl[:] = 2.0, 0.3
    mujoco.mj_step(model, data, 400)
    ends.append(data.qpos[:2].copy())
  batch.reset()
  batch.bind("eq_active")[:] = switched
  batch.ctrl[:] = [2.0, 0.3]
  batch.step(nstep=400)
  np.testing.assert_allclose(batch.qpos[0, :2], ends[0], atol=1e-6)
  assert np.linalg.norm(ends[0] - ends[1]) > 1e-3  # and it matters


def test_stays_finite_for_any_car_a_fit_may_try():
  """At the longest step, numbers far outside the nominal ones, random voltages and steering."""
  random = np.random.default_rng(7)
  spread = {"rotor_inertia": 40, "cornering_stiffness_front": 8, "cornering_stiffness_rear": 8, "cg_height": 1.8}
  spread |= {"longitudinal_stiffness": 4, "friction_coefficient": 3, "driveline_friction": 10, "torque_per_volt": 4}
  for car in CARS * 8:
    changes = {name: getattr(car, name) * factor ** random.uniform(-1, 1) for name, factor in spread.items()}
    changes |= {name: random.uniform(0, 0.15) for name in ("relaxation_length", "longitudinal_relaxation")}
    changes |= {"ackermann_fraction": random.uniform(-0.5, 1.6)}
    model = car_spec(dataclasses.replace(car, **changes), timestep=0.005).compile()
    data = mujoco.MjData(model)
    for _ in range(12):
      data.ctrl[:] = random.uniform(-3, 4), random.uniform(-0.5, 0.5)
      mujoco.mj_step(model, data, 20)
      assert np.abs(data.qvel[:6]).max() < 40.0 and not data.warning.number.any()
