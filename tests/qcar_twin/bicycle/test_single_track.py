"""The single-track equations against exact solutions: matrix exponential, friction to rest, limits."""

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from qcar_twin import kinematics
from qcar_twin.bicycle import single_track
from qcar_twin.bicycle.single_track import SingleTrackCar, State

CAR = SingleTrackCar(4800.0, 8.0, 1600.0, 150.0, 210.0, 2.7, 0.030, 0.120, 0.136, 0.0953668 * 0.033)
OVERSTEER = dataclasses.replace(CAR, cornering_stiffness_front=230.0, cornering_stiffness_rear=120.0)


def holding_voltage(speed, car=CAR):
  omega = speed / car.rolling_radius
  return (car.drive_damping * omega + car.drive_friction * np.sign(omega)) / car.drive_gain


def run(x, u, duration, steps, car=CAR):
  for _ in range(steps):
    x = single_track.step(x, u, duration / steps, car)
  return x


# -- drive ---------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.floats(-400.0, 400.0), st.floats(-3.0, 3.0), st.floats(0.0, 2.0), st.floats(0.001, 1.0))
@example(1.0, 5e-324, 0.0, 1.0)
def test_motor_is_a_semigroup_through_rest_and_reversal(start, voltage, friction_scale, duration):
  """One long step equals many short ones, whatever rest or reversal lies between."""
  numbers = 480.0, 8.0, 200.0 * friction_scale
  once = single_track.motor_speed_after(start, voltage, duration, *numbers)
  many = np.float64(start)
  for _ in range(7):
    many = single_track.motor_speed_after(many, voltage, duration / 7, *numbers)
  np.testing.assert_allclose(many, once, atol=1e-9)


def test_motor_stops_when_friction_has_taken_its_speed_and_stays():
  """Coasting from omega_0 ends after log(1 + P2 omega_0 / P3) / P2."""
  omega, damping, friction = 120.0, 8.0, 200.0
  end = np.log1p(damping * omega / friction) / damping
  before = single_track.motor_speed_after(omega, 0.0, 0.999 * end, 480.0, damping, friction)
  assert 0.0 < before < 0.5
  for duration in (1.0001 * end, 2.0 * end, 100.0):
    assert single_track.motor_speed_after(omega, 0.0, duration, 480.0, damping, friction) == 0.0


def test_friction_holds_up_to_its_threshold_and_not_beyond():
  threshold = 200.0 / 480.0
  voltages = np.array([-1.001, -0.999, 0.0, 0.999, 1.001]) * threshold
  after = single_track.motor_speed_after(0.0, voltages, 5.0, 480.0, 8.0, 200.0)
  assert np.all(np.sign(after) == [-1, 0, 0, 0, 1])


def test_motor_settles_at_the_papers_steady_speed():
  after = single_track.motor_speed_after(0.0, 1.5, 50.0, 480.0, 8.0, 200.0)
  np.testing.assert_allclose(after, (480.0 * 1.5 - 200.0) / 8.0, rtol=1e-12)


def test_braking_through_zero_matches_an_integrator_with_events():
  def slope(_, omega, sign):
    return [480.0 * -1.2 - 8.0 * omega[0] - 200.0 * sign]

  def crosses(_, omega, sign):
    return omega[0]

  crosses.terminal = True  # type: ignore[attr-defined]
  tight = dict(rtol=1e-11, atol=1e-11)
  first = solve_ivp(slope, (0, 1), [150.0], events=crosses, args=(1.0,), **tight)
  second = solve_ivp(slope, (first.t[-1], 0.4), [0.0], args=(-1.0,), **tight)
  stopped = single_track.motor_speed_after(150.0, -1.2, 0.4, 480.0, 8.0, 200.0)
  np.testing.assert_allclose(stopped, second.y[0, -1], rtol=1e-7)


# -- lateral -------------------------------------------------------------------------------------


@pytest.mark.parametrize("car", [CAR, OVERSTEER])
@pytest.mark.parametrize("speed", [0.25, 0.7, 1.5, 2.2, -0.6])
def test_constant_speed_equals_the_matrix_exponential(car, speed):
  """Sideslip, yaw rate and yaw against scipy's expm of the paper's equations, written out again here."""
  m, i, a, b = car.mass, car.yaw_inertia, car.cg_to_front, car.cg_to_rear
  cf, cr, s, v = car.cornering_stiffness_front, car.cornering_stiffness_rear, np.sign(speed), speed
  system = np.zeros((4, 4))  # beta, r, psi, delta
  system[0] = [-(cf + cr) * s / (m * v), -s * (cf * a - cr * b) / (m * v**2) - 1, 0, s * cf / (m * v)]
  system[1] = [-s * (cf * a - cr * b) / i, -s * (cf * a**2 + cr * b**2) / (i * v), 0, s * cf * a / i]
  system[2, 1] = 1.0
  x = np.array([0.3, -0.2, speed, 0.4, 0.05, -0.3])
  u = np.array([holding_voltage(speed, car), 0.15])
  after = run(x, u, 0.2, 20, car)
  expected = expm(system * 0.2) @ [0.05, -0.3, 0.4, 0.15]
  np.testing.assert_allclose(after[[4, 5, 3]], expected[:3], atol=1e-10)
  np.testing.assert_allclose(after[State.SPEED], speed, rtol=1e-12)


def test_step_converges_to_an_accurate_integration_of_f():
  """Acceleration, turning and position against a tight Runge-Kutta solution of `derivative`."""
  x, u = np.array([0.0, 0.0, 0.6, 0.2, 0.0, 0.0]), np.array([2.5, 0.25])
  exact = solve_ivp(
    lambda _, z: single_track.derivative(z, u, CAR), (0.0, 0.5), x, rtol=1e-10, atol=1e-12, method="LSODA"
  ).y[:, -1]
  np.testing.assert_allclose(run(x, u, 0.5, 50), exact, atol=2e-4)
  errors = [np.abs(run(x, u, 0.5, n) - exact).max() for n in (50, 100)]
  assert errors[1] < 0.3 * errors[0]  # second order


@given(st.floats(-0.4, 0.4), st.floats(0.0, 0.09), st.sampled_from([-1.0, 1.0]))
def test_low_speed_is_the_no_slip_motion(steering, speed, direction):
  speed = speed * direction
  x = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
  after = run(x, np.array([holding_voltage(speed), steering]), 0.1, 10)
  expected = single_track.no_slip_motion(speed, steering, CAR)
  np.testing.assert_allclose(after[State.LATERAL], expected, atol=1e-9)


def test_equations_pass_smoothly_into_the_low_speed_limit():
  """f and the stepped state change by little over a fine grid of speeds through the transition."""
  speeds = np.linspace(-0.3, 0.3, 6001)
  x = np.zeros((len(speeds), State.SIZE))
  x[:, State.SPEED] = speeds
  u = np.stack([holding_voltage(speeds), np.full_like(speeds, 0.2)], axis=-1)
  after = run(x, u, 0.05, 5)
  assert np.all(np.isfinite(after))
  no_slip = single_track.no_slip_motion(speeds, 0.2, CAR)
  assert np.abs(after[:, State.LATERAL] - no_slip).max() < 0.01
  jumps = np.abs(np.diff(after[:, State.LATERAL], axis=0)).max()
  assert jumps < 3e-4


def test_standstill_with_steered_wheels_stays_put():
  x = np.array([1.0, 2.0, 0.0, 0.3, 0.0, 0.0])
  after = run(x, np.array([0.2, 0.3]), 1.0, 100)
  np.testing.assert_array_equal(after[[0, 1, 2, 3, 5]], x[[0, 1, 2, 3, 5]])


def test_huge_stiffness_is_stable_and_rolls_without_slip():
  stiff = dataclasses.replace(CAR, cornering_stiffness_front=2e4, cornering_stiffness_rear=2e4)
  after = run(np.array([0, 0, 1.0, 0, 0, 0]), np.array([holding_voltage(1.0), 0.2]), 0.5, 50, stiff)
  np.testing.assert_allclose(after[State.LATERAL], single_track.no_slip_motion(1.0, 0.2, stiff), rtol=0.03)


def test_steady_circle_is_the_closed_form():
  speed, steering = 1.5, 0.1
  after = run(np.array([0, 0, speed, 0, 0, 0]), np.array([holding_voltage(speed), steering]), 3.0, 300)
  numbers = CAR.mass, CAR.cg_to_front, CAR.cg_to_rear
  gradient = kinematics.understeer_gradient(*numbers, CAR.cornering_stiffness_front, CAR.cornering_stiffness_rear)
  wheelbase = CAR.cg_to_front + CAR.cg_to_rear
  yaw_rate = steering * kinematics.yaw_rate_gain(speed, wheelbase, gradient)
  sideslip = steering * kinematics.sideslip_gain(speed, *numbers, CAR.cornering_stiffness_rear, gradient)
  np.testing.assert_allclose(after[State.LATERAL], [sideslip, yaw_rate], atol=1e-9)


def test_critical_speed_of_oversteer_is_finite_and_right():
  """det A = 0: A has no inverse, the state still follows its integral."""
  numbers = OVERSTEER.mass, OVERSTEER.cg_to_front, OVERSTEER.cg_to_rear
  gradient = kinematics.understeer_gradient(
    *numbers, OVERSTEER.cornering_stiffness_front, OVERSTEER.cornering_stiffness_rear
  )
  critical = np.sqrt(-(OVERSTEER.cg_to_front + OVERSTEER.cg_to_rear) / gradient)
  speeds = critical * np.array([1.0 - 1e-5, 1.0, 1.0 + 1e-5])
  x = np.zeros((3, State.SIZE))
  x[:, State.SPEED] = speeds
  after = run(x, np.stack([holding_voltage(speeds, OVERSTEER), np.full(3, 0.02)], axis=-1), 0.3, 30, OVERSTEER)
  np.testing.assert_allclose(after[1], 0.5 * (after[0] + after[2]), rtol=1e-5)


@pytest.mark.parametrize("scale", [0.0, 1e-6, 0.05, 1.0, 40.0])
def test_exponential_and_its_integrals_equal_an_augmented_exponential(scale):
  """Random, singular, defective and vanishing matrices against scipy's expm of the block matrix."""
  matrices = scale * np.array(
    [[[-3.0, 1.0], [-2.0, -5.0]], [[1.0, 2.0], [2.0, 4.0]], [[-2.0, 1.0], [0.0, -2.0]], [[-1.0, 9.0], [-9.0, -1.0]]]
  )
  integrals = single_track.exponential_integrals(matrices, 0.1)
  for k, matrix in enumerate(matrices):
    block = np.zeros((6, 6))
    block[:2, :2], block[:2, 2:4], block[2:4, 4:] = matrix, np.eye(2), np.eye(2)
    exact = expm(0.1 * block)
    for f, expected in zip(integrals, (exact[:2, :2], exact[:2, 2:4], exact[:2, 4:]), strict=True):
      np.testing.assert_allclose(f[k], expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


# -- whole state ---------------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.floats(-2.0, 2.0), st.floats(-0.4, 0.4), st.floats(-3.0, 3.0), st.floats(-0.2, 0.2))
def test_mirrored_commands_give_mirrored_motion(speed, steering, voltage, sideslip):
  sign = np.array([1.0, -1.0, 1.0, -1.0, -1.0, -1.0])
  x, u = np.array([0.0, 0.1, speed, 0.2, sideslip, 0.3]), np.array([voltage, steering])
  after, mirrored = run(x, u, 0.1, 10), run(sign * x, u * [1.0, -1.0], 0.1, 10)
  np.testing.assert_allclose(mirrored, sign * after, atol=1e-12)
