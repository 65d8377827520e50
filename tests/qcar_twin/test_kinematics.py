"""Kinematics against geometry: exact turning circles, round trips, mirrored motion, limits."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from qcar_twin import kinematics
from qcar_twin.vehicle.vehicle import Vehicle

LENGTHS = (0.128, 0.140)  # m, front and rear
angles = st.floats(-0.5, 0.5)
speeds = st.floats(-2.0, 2.0)


def world_to_body(yaw, x, y):
  return kinematics.body_to_world(-np.asarray(yaw), x, y)


@given(st.floats(-50.0, 50.0))
def test_wrapped_angle_is_the_same_direction_in_half_open_turn(angle):
  wrapped = kinematics.wrap_angle(angle)
  assert -np.pi < wrapped <= np.pi
  np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-12)


def test_wrap_keeps_pi_and_turns_minus_pi_to_pi():
  np.testing.assert_array_equal(kinematics.wrap_angle([np.pi, -np.pi, 0.0]), [np.pi, np.pi, 0.0])


@given(st.floats(-4.0, 4.0), speeds, speeds)
def test_frames_are_inverse_and_keep_length(yaw, x, y):
  there = kinematics.body_to_world(yaw, x, y)
  np.testing.assert_allclose(world_to_body(yaw, *there), (x, y), atol=1e-12)
  np.testing.assert_allclose(np.hypot(*there), np.hypot(x, y), atol=1e-12)


def test_body_forward_at_quarter_turn_points_to_world_left():
  np.testing.assert_allclose(kinematics.body_to_world(np.pi / 2, 1.0, 0.0), (0.0, 1.0), atol=1e-15)


def test_transport_matches_derivatives_of_a_point_on_a_moving_body():
  """Position of the point differentiated numerically, against the closed form."""
  time = np.linspace(0.0, 1.0, 20001)
  step, point = time[1], (0.07, -0.03)
  yaw, x, y = 0.4 * np.sin(3 * time), time**2, 0.3 * np.cos(2 * time)
  yaw_rate, yaw_acceleration = 1.2 * np.cos(3 * time), -3.6 * np.sin(3 * time)
  accel = world_to_body(yaw, 2.0 + 0 * time, -1.2 * np.cos(2 * time))
  arm = kinematics.body_to_world(yaw, *point)
  place = np.array([x + arm[0], y + arm[1]])
  first = np.gradient(place, step, axis=1)
  second = np.gradient(first, step, axis=1)
  inner = slice(5, -5)
  expected = np.array(world_to_body(yaw, *second))[:, inner]
  transported = np.array(kinematics.transport_acceleration(*accel, yaw_rate, yaw_acceleration, *point))
  np.testing.assert_allclose(transported[:, inner], expected, atol=1e-4)


@given(angles, st.floats(0.05, 2.0), st.sampled_from([-1.0, 1.0]))
def test_kinematic_motion_has_no_slip_at_either_axle(steering, speed, direction):
  """The no-slip sideslip and yaw rate let both axles move where their wheels point, in reverse too."""
  front, rear = LENGTHS
  speed = direction * speed
  sideslip = kinematics.kinematic_sideslip_angle(steering, front, rear)
  yaw_rate = kinematics.kinematic_yaw_rate(speed, steering, front, rear)
  velocity = speed * np.cos(sideslip), speed * np.sin(sideslip)
  np.testing.assert_allclose(velocity[1] - yaw_rate * rear, 0.0, atol=1e-12)
  np.testing.assert_allclose(velocity[1] + yaw_rate * front, velocity[0] * np.tan(steering), atol=1e-12)
  np.testing.assert_allclose(kinematics.sideslip_angle(*velocity), sideslip, atol=1e-12)


def test_sideslip_is_zero_at_standstill():
  assert kinematics.sideslip_angle(0.0, 0.0) == 0.0


CAR = dict(mass=2.7, cg_to_front=0.128, cg_to_rear=0.140)


@given(st.floats(50.0, 400.0), st.floats(50.0, 400.0), st.floats(0.3, 1.5))
def test_steady_gains_solve_the_force_and_moment_balance(front, rear, speed):
  """Put the gains back into the balance of lateral force and yaw moment."""
  gradient = kinematics.understeer_gradient(**CAR, cornering_stiffness_front=front, cornering_stiffness_rear=rear)
  wheelbase = CAR["cg_to_front"] + CAR["cg_to_rear"]
  if wheelbase + gradient * speed**2 < 0.05:  # beyond the critical speed of an oversteering car
    return
  yaw_rate = kinematics.yaw_rate_gain(speed, wheelbase, gradient)
  sideslip = kinematics.sideslip_gain(speed, **CAR, cornering_stiffness_rear=rear, gradient=gradient)
  force_front = -front * (sideslip + CAR["cg_to_front"] * yaw_rate / speed - 1.0)
  force_rear = -rear * (sideslip - CAR["cg_to_rear"] * yaw_rate / speed)
  scale = front + rear
  moment = CAR["cg_to_front"] * force_front - CAR["cg_to_rear"] * force_rear
  assert abs(moment) < 1e-9 * scale
  assert abs(force_front + force_rear - CAR["mass"] * speed * yaw_rate) < 1e-9 * scale
  exact = kinematics.steering_per_lateral_acceleration(speed, wheelbase, gradient)
  np.testing.assert_allclose(exact * speed * yaw_rate, 1.0, rtol=1e-12)


def _printed_and_exact(front, rear, speed):
  lengths = CAR["cg_to_front"], CAR["cg_to_rear"]
  gradient = kinematics.understeer_gradient(CAR["mass"], *lengths, front, rear)
  printed = kinematics.steering_per_lateral_acceleration_as_printed(speed, *lengths, front, rear)
  return printed, kinematics.steering_per_lateral_acceleration(speed, sum(lengths), gradient)


@given(st.floats(50.0, 400.0), st.floats(0.3, 3.0))
def test_printed_steady_state_is_exact_where_axles_balance(front, speed):
  balanced = front * CAR["cg_to_front"] / CAR["cg_to_rear"]
  np.testing.assert_allclose(*_printed_and_exact(front, balanced, speed), rtol=1e-12)


@given(st.floats(50.0, 400.0), st.floats(0.5, 2.0), st.floats(0.3, 1.5))
def test_printed_steady_state_is_exact_only_there_and_where_sideslip_vanishes(front, ratio, speed):
  rear = ratio * front * CAR["cg_to_front"] / CAR["cg_to_rear"]
  wheelbase = CAR["cg_to_front"] + CAR["cg_to_rear"]
  bare = CAR["cg_to_rear"] - CAR["mass"] * CAR["cg_to_front"] * speed**2 / (rear * wheelbase)
  printed, exact = _printed_and_exact(front, rear, speed)
  np.testing.assert_allclose((printed - exact) * speed**2, (ratio - 1.0) * bare, atol=1e-12)
  no_sideslip = np.sqrt(CAR["cg_to_rear"] * rear * wheelbase / (CAR["mass"] * CAR["cg_to_front"]))
  np.testing.assert_allclose(*_printed_and_exact(front, rear, no_sideslip), rtol=1e-9)


@given(st.floats(-500.0, 500.0))
def test_motor_and_road_speed_undo_each_other(omega):
  car = Vehicle(gear_ratio=0.1, wheel_radius=0.03)
  speed = kinematics.road_speed(omega, car)
  np.testing.assert_allclose(speed, 0.003 * omega, rtol=1e-12, atol=1e-300)
  np.testing.assert_allclose(speed, omega * kinematics.rolling_radius(car), rtol=1e-12, atol=1e-300)
  np.testing.assert_allclose(kinematics.motor_speed(speed, car), omega, rtol=1e-12, atol=1e-300)
