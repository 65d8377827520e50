"""Differentials within the axles and between them: torques against what wheels differ in."""

import dataclasses

import mujoco
import numpy as np
import pytest

from qcar_twin.twin.parameters import base_parameters
from qcar_twin.vehicle.ids import Handles
from qcar_twin.vehicle.mjcf import car_spec, centre_damping, differential_rows
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()


@pytest.mark.parametrize("preload", [0.005, 0.02])
def test_a_differentials_preload_is_a_constant_torque_against_the_difference(preload):
  model = car_spec(CAR, timestep=0.005).compile()
  for axle in ("front", "rear"):
    model.tendon_frictionloss[model.tendon(f"{axle}_differential").id] = preload
  data, handles = mujoco.MjData(model), Handles.of(model)
  data.ctrl[:] = 1.5, 0.4
  mujoco.mj_step(model, data, 800)
  spin = data.qvel[list(handles.spin_dofs)]
  assert spin[1] - spin[0] > 1.0 and spin[3] - spin[2] > 1.0  # it is overcome
  torque = data.qfrc_constraint[handles.spin_dofs[1]] - data.qfrc_constraint[handles.spin_dofs[0]]
  tyres = [data.efc_force[c.efc_address + 1] * CAR.wheel_radius for c in data.contact][:2]
  assert torque + tyres[1] - tyres[0] == pytest.approx(-2 * preload, rel=0.02)


@pytest.mark.parametrize("h", [0.002, 0.005])
@pytest.mark.parametrize("damping", [1e-3, 0.05, 5.0])
def test_differential_damping_is_a_torque_against_the_difference(damping, h):
  model = car_spec(CAR, timestep=h).compile()
  handles = Handles.of(model)
  for axle in ("front", "rear"):
    row = model.equality(f"{axle}_differential").id
    invweight = model.tendon_invweight0[model.tendon(f"{axle}_differential").id]
    (model.eq_solref[row],), (model.eq_solimp[row],) = differential_rows(damping, h, invweight)
    model.eq_active0[row] = 1
  data = mujoco.MjData(model)
  data.ctrl[:] = 0.8, 0.4
  mujoco.mj_step(model, data, round(4 / h))
  spin = data.qvel[list(handles.spin_dofs)]
  torque = data.qfrc_constraint[handles.spin_dofs[1]] - data.qfrc_constraint[handles.spin_dofs[0]]
  tyres = [data.efc_force[c.efc_address + 1] * CAR.wheel_radius for c in data.contact][:2]
  assert torque + tyres[1] - tyres[0] == pytest.approx(-2 * damping * (spin[1] - spin[0]), rel=0.02)


@pytest.mark.parametrize("freedom", [0.3, 0.7, 1.0])
def test_a_centre_differential_is_a_torque_against_what_the_axles_differ_in(freedom):
  car = dataclasses.replace(CAR, centre_differential=freedom)
  model = car_spec(car, timestep=0.005).compile()
  assert 1.0 / car.wheel_inertia == pytest.approx(model.tendon_invweight0[model.tendon("centre").id], rel=1e-6)
  data, handles = mujoco.MjData(model), Handles.of(model)
  data.ctrl[:] = 0.8, 0.4
  mujoco.mj_step(model, data, 800)
  spin = data.qvel[list(handles.spin_dofs)]
  assert spin.mean() == pytest.approx(car.gear_ratio * data.qvel[handles.motor_dof], rel=1e-4)
  equalities = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
  row = np.flatnonzero(equalities & (data.efc_id == model.equality("centre").id))
  apart = spin[:2].mean() - spin[2:].mean()
  assert apart > 0.2
  assert data.efc_force[row[0]] == pytest.approx(-float(centre_damping(freedom)) * apart, rel=0.02, abs=1e-5)


def test_axles_on_one_shaft_turn_alike_and_one_driven_axle_has_no_centre():
  model = car_spec(CAR, timestep=0.005).compile()
  data, handles = mujoco.MjData(model), Handles.of(model)
  data.ctrl[:] = 0.8, 0.4
  mujoco.mj_step(model, data, 800)
  spin = data.qvel[list(handles.spin_dofs)]
  assert spin[:2].mean() == pytest.approx(spin[2:].mean(), rel=1e-4)
  assert "centre_differential" in base_parameters(CAR).names
  rear = dataclasses.replace(CAR, layout="rear")
  assert "centre_differential" not in base_parameters(rear).names
  model = car_spec(rear).compile()
  names = [model.tendon(t).name for t in range(model.ntendon)]
  assert "centre" not in names and "axles" not in names
  with pytest.raises(ValueError, match=r"centre_differential must be from 0 \(one shaft\) to 1 \(open\), not 1.5"):
    dataclasses.replace(CAR, centre_differential=1.5)
