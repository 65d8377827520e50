"""Elementary responses against closed forms and independent integrators."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from qcar_twin.twin.mechanisms import elements
from tests.qcar_twin.twin.mechanisms.mechanism_bench import CAR, PERIOD, BenchModel, drive

reals = st.floats(-3.0, 3.0)


@given(reals, st.floats(0.0, 1.0))
def test_dead_zone_is_odd_and_near_its_sharp_form(x, half_width):
  x, half_width = np.array([x]), np.array([half_width])
  smooth = elements.dead_zone(x, half_width)
  sharp = np.sign(x) * np.maximum(np.abs(x) - half_width, 0.0)
  np.testing.assert_allclose(smooth, sharp, atol=elements.KINK)
  np.testing.assert_allclose(elements.dead_zone(-x, half_width), -smooth, atol=1e-12)


@given(reals)
def test_dead_zone_of_no_width_is_the_identity(x):
  assert elements.dead_zone(np.array([x]), np.zeros(1))[0] == x


@given(reals)
def test_rounded_kinks_stay_close_and_do_not_move_zero(x):
  x = np.array([x])
  np.testing.assert_allclose(elements.smooth_abs(x), np.abs(x), atol=elements.KINK)
  np.testing.assert_allclose(elements.ramp(x), np.maximum(x, 0.0), atol=elements.KINK)
  assert elements.ramp(-np.abs(x))[0] == 0.0 and elements.smooth_abs(np.zeros(1))[0] == 0.0


def _reference(lag, inertia, targets, start):
  """The same differential equation by a general integrator: output at the ends and mean over each period."""
  y, rate, mean, end = start, 0.0, [], []
  for target in targets:
    motion = solve_ivp(
      lambda _, s, u=target: [s[1], (u - s[0] - lag * s[1]) / (inertia * lag**2), s[0]],
      (0.0, PERIOD),
      [y, rate, 0.0],
      rtol=1e-10,
      atol=1e-12,
    ).y[:, -1]
    y, rate = motion[0], motion[1]
    end.append(y)
    mean.append(motion[2] / PERIOD)
  return np.array(mean), np.array(end)


@pytest.mark.parametrize("inertia", [0.05, 0.25, 0.5, 1.5])
@pytest.mark.parametrize("lag", [0.004, 0.05])
def test_lag_is_the_exact_solution_for_held_targets(lag, inertia):
  targets = [0.3, 0.3, -0.2, 0.1, 0.1, 0.1, 0.4]
  state = elements.second_order(np.array([lag]), np.array([inertia]), PERIOD)
  state |= {"output": np.array([0.1]), "rate": np.zeros(1)}
  means, ends = [], []
  for target in targets:
    means.append(elements.lag_step(state, np.array([target]))[0])
    ends.append(state["output"][0])
  mean, end = _reference(lag, inertia, targets, 0.1)
  np.testing.assert_allclose(ends, end, atol=1e-7)
  np.testing.assert_allclose(means, mean, atol=1e-7)


def test_lag_without_inertia_is_first_order():
  lag = np.array([0.03, 0.2])
  state = elements.second_order(lag, np.zeros(2), PERIOD) | {"output": np.zeros(2), "rate": np.zeros(2)}
  for k in range(1, 20):
    elements.lag_step(state, np.ones(2))
    np.testing.assert_allclose(state["output"], 1.0 - np.exp(-k * PERIOD / lag), atol=2e-6)


def test_lag_delays_a_ramp_by_its_lag_whatever_the_damping():
  inertia = np.array([0.0, 0.1, 0.25, 0.5, 2.0])
  lag = np.full(5, 0.04)
  state = elements.second_order(lag, inertia, PERIOD) | {"output": np.zeros(5), "rate": np.zeros(5)}
  for k in range(400):
    mean = elements.lag_step(state, np.full(5, k * PERIOD))
  np.testing.assert_allclose(399 * PERIOD - mean, 0.04, atol=1e-5)


def test_no_lag_passes_the_target():
  state = elements.second_order(np.zeros(1), np.full(1, 0.3), PERIOD) | {"output": np.zeros(1), "rate": np.zeros(1)}
  for target in (1.0, -2.0, 0.5):
    np.testing.assert_allclose(elements.lag_step(state, np.array([target])), target, atol=1e-8)


def test_delay_of_whole_periods_gives_back_old_commands():
  commands = np.random.default_rng(1).normal(size=(30, 3))
  state = elements.delay_line(np.array([0.0, 0.02, 0.07]), PERIOD, 0.1, commands[0], commands[0])
  delayed = np.array([elements.delay_step(state, c) for c in commands])
  for row, shift in enumerate((0, 2, 7)):
    np.testing.assert_allclose(delayed[shift:, row], commands[: 30 - shift, row], rtol=1e-12)
    np.testing.assert_allclose(delayed[:shift, row], commands[0, row], rtol=1e-14)


def test_delay_of_a_part_is_the_mean_over_the_period():
  """A command held over periods and read 3.4 periods late covers 0.6 of one period and 0.4 of the one before."""
  commands = np.random.default_rng(2).normal(size=(12, 1))
  state = elements.delay_line(np.array([0.034]), PERIOD, 0.1, commands[0], commands[0])
  delayed = np.array([elements.delay_step(state, c) for c in commands])
  np.testing.assert_allclose(delayed[4:], 0.6 * commands[1:9] + 0.4 * commands[:8], atol=1e-12)


def test_delay_at_its_longest_stays_in_the_line():
  state = elements.delay_line(np.array([0.1]), PERIOD, 0.1, np.ones(1), np.zeros(1))
  delayed = [elements.delay_step(state, np.full(1, 5.0))[0] for _ in range(14)]
  assert delayed[9] < 5.0 and delayed[10] == 5.0


@given(st.lists(st.floats(0.0, 0.1), min_size=1, max_size=4), st.integers(1, 60))
def test_delay_of_any_length_reads_the_line_through_old_commands(delays, steps):
  commands = np.random.default_rng(steps).normal(size=(steps, len(delays)))
  state = elements.delay_line(np.array(delays), PERIOD, 0.1, commands[0], commands[0])
  delayed = np.array([elements.delay_step(state, c) for c in commands])
  at = np.arange(steps)
  for row, delay in enumerate(delays):
    wanted = np.interp(at - delay / PERIOD, at, commands[:, row])  # held at the first one before it
    np.testing.assert_allclose(delayed[:, row], wanted, atol=1e-9)


def test_delay_begins_with_a_straight_line_from_what_acted_before():
  state = elements.delay_line(np.array([0.04]), PERIOD, 0.1, np.array([1.0]), np.array([0.2]))
  delayed = [elements.delay_step(state, np.ones(1))[0] for _ in range(6)]
  np.testing.assert_allclose(delayed, [0.2, 0.4, 0.6, 0.8, 1.0, 1.0], atol=1e-12)


@given(st.floats(-3.0, 3.0))
def test_shift_of_a_straight_line_is_exact(samples):
  line = np.arange(12.0)[None] * 0.5 + 2.0
  shifted = elements.shifted(line, np.array([[samples]]), extrapolate=True)
  np.testing.assert_allclose(shifted, line - 0.5 * samples, atol=1e-12)
  held = elements.shifted(line, np.array([[samples]]))
  np.testing.assert_allclose(held, np.clip(line - 0.5 * samples, line[0, 0], line[0, -1]), atol=1e-12)


def test_shift_may_grow_along_the_track_and_differ_by_row():
  track = np.sin(np.linspace(0, 3, 200))[None].repeat(2, axis=0)
  late = np.stack([np.linspace(0.0, 8.0, 200), np.full(200, 3.0)])
  late_track = elements.shifted(track, late)
  position = np.clip(np.arange(200) - late, 0, 199)
  np.testing.assert_allclose(late_track, np.sin(position * 3 / 199), atol=1e-4)


def test_the_slope_of_a_shift_does_not_jump_at_a_whole_sample():
  """Of a jagged track: a straight line's does, by the track's second difference."""
  track = np.random.default_rng(2).normal(size=(1, 30))
  at = lambda samples: elements.shifted(track, np.array([[samples]]))
  for whole in (-2.0, 0.0, 3.0):
    before, after = (at(whole) - at(whole - 1e-6)) / 1e-6, (at(whole + 1e-6) - at(whole)) / 1e-6
    np.testing.assert_allclose(after[:, 5:-5], before[:, 5:-5], atol=1e-4)
  np.testing.assert_allclose(at(3.0)[:, 3:], track[:, :-3], atol=1e-12)


def test_a_shift_beyond_the_track_holds_its_ends_or_goes_on_along_them():
  track = np.array([[1.0, 2.0, 4.0]])
  far = np.array([[7.5]])
  np.testing.assert_allclose(elements.shifted(track, far), [[1.0, 1.0, 1.0]])
  np.testing.assert_allclose(elements.shifted(track, -far), [[4.0, 4.0, 4.0]])
  np.testing.assert_allclose(elements.shifted(track, far, extrapolate=True), [[-6.5, -5.5, -4.5]])


def test_track_of_one_sample_survives_a_shift():
  np.testing.assert_array_equal(elements.shifted(np.array([[4.0]]), np.array([[2.5]])), [[4.0]])


def test_idle_voltage_drives_no_current_and_force_is_power_over_speed():
  context = drive(n=4).context(3)
  idle = elements.idle_voltage(context)
  torque = context.torque_per_volt * idle - context.motor_damping * context.signal("motor_speed")
  np.testing.assert_allclose(torque, 0.0, atol=1e-12)
  volts = context.commands[:, 0]
  power = (context.torque_per_volt * volts - context.motor_damping * context.signal("motor_speed")) * 100.0
  speed = 100.0 * CAR.gear_ratio * CAR.wheel_radius
  np.testing.assert_allclose(elements.drive_force(context) * speed, power, rtol=1e-12)
  np.testing.assert_allclose(elements.rolling_torque(np.array([2.0]), context) * 100.0, 2.0 * speed, rtol=1e-12)


def test_backdrop_is_nothing_at_rest_and_the_command_under_way():
  context = drive(n=2).context(0)
  context.signals = np.zeros((2, 10))
  context.signals[1, 3] = 0.8
  np.testing.assert_allclose(elements.backdrop(context), [0.0, context.commands[1, 0]], atol=1e-9)


def test_grip_scales_friction_fully_and_stiffness_by_its_share():
  model, before = BenchModel(2), BenchModel(2)
  elements.scale_grip(model, np.full((2, 4), -0.4), np.array([[0.0], [0.5]]))
  ratio = {k: model.values[k] / before.values[k] for k in model.values if np.all(before.values[k] != 0)}
  np.testing.assert_allclose(ratio["friction_coefficient"], 0.6)
  np.testing.assert_allclose(ratio["cornering_stiffness"], np.repeat([[1.0], [0.8]], 4, axis=1))
  np.testing.assert_allclose(ratio["longitudinal_stiffness"], ratio["cornering_stiffness"])
  elements.scale_grip(model, np.full((2, 4), -9.0), np.ones((2, 1)))
  assert np.all(model.values["friction_coefficient"] > 0)


def test_replaced_puts_in_columns_by_name_and_copies():
  track = drive(n=2, steps=6).track()
  out = elements.replaced(track, yaw_rate=np.full((2, 6), 7.0))
  assert np.all(out[..., 5] == 7.0) and not np.any(track.signals[..., 5] == 7.0)
  with pytest.raises(KeyError, match="yaw_rate"):
    elements.replaced(track, yaw_rates=np.zeros((2, 6)))
  own = dataclasses.replace(track, own=True)
  assert elements.replaced(own, yaw_rate=np.full((2, 6), 7.0)) is own.signals
  np.testing.assert_array_equal(own.signals, out)
