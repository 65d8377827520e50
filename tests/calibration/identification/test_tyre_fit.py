"""Tyres from step steers: exact recovery, the printed steady state's bias, the lagged transient, missing channels."""

import dataclasses

import numpy as np
import pytest

from calibration.identification import transient_single_track as transient
from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.steering_steps import LinearResponses, find_turns, fit_steady_turns, turning_drag
from calibration.identification.step_detection import moving_average
from calibration.identification.tyre_fit import fit_lateral
from qcar_twin import kinematics
from qcar_twin.bicycle.bicycle import TurningLosses
from qcar_twin.bicycle.single_track import SingleTrackCar, lateral_transition
from qcar_twin.recordings.recording import Recording
from tests.calibration.identification.bicycle_rig import (
  DEGREES,
  EXACT_STD,
  PERIOD,
  THETA,
  VEHICLE,
  session,
  steering_steps,
)

TRUTH = THETA[3:]
LENGTHS = VEHICLE.cg_to_front, VEHICLE.cg_to_rear
GRADIENT = float(kinematics.understeer_gradient(VEHICLE.mass, *LENGTHS, *TRUTH))


steers = steering_steps


# -- the linear transient ------------------------------------------------------------------------


def test_bicycle_s_answers_equal_its_own_recordings():
  """Simulated at the measured speed, filtered alike: only the speed's own filter is left."""
  for turn in find_turns(steers(), VEHICLE):
    model = LinearResponses([turn], VEHICLE).model(TRUTH)
    for name in ("yaw_rate", "accel_y"):
      measured = moving_average(turn.signals[name])
      np.testing.assert_allclose(model[name][0], measured, atol=2e-3 * np.abs(measured).max())


def test_steady_state_of_the_simulation_is_the_closed_form_to_one_part_in_a_million():
  for turn in find_turns(steers(), VEHICLE):
    end = slice(-50, None)
    gain = kinematics.yaw_rate_gain(turn.speed[end], sum(LENGTHS), GRADIENT)
    np.testing.assert_allclose(turn.signals["yaw_rate"][end], turn.step.level * gain, rtol=1e-6)


def test_exact_linear_fit_gives_back_the_parameters():
  fit = fit_lateral(steers(), VEHICLE, EXACT_STD, "exact", "linear")
  np.testing.assert_allclose(fit.values, TRUTH, rtol=5e-3)
  np.testing.assert_allclose(fit.understeer_gradient, GRADIENT, atol=1e-5)
  assert all(s.rmse_percent < 0.2 for s in fit.steps + fit.yaw_rate_steps)
  assert len(fit.steps) == len(fit.yaw_rate_steps) == 7
  assert all(abs(s.measured - s.model) < 2e-3 for s in fit.yaw_rate_steps)


def test_exact_linear_estimates_lie_within_three_deviations_over_seeds():
  scores = []
  for seed in range(4):
    fit = fit_lateral(steers(noise=1.0, seed=seed), VEHICLE, EXACT_STD, "exact", "linear")
    scores.append((np.array(fit.values) - TRUTH) / np.sqrt(np.diag(fit.covariance)))
  assert np.abs(scores).max() < 3.0


def test_printed_fit_is_right_only_if_the_axles_balance():
  """With C_f L_f = C_r L_r it gives the truth back; else its steady state is biased as the closed form says."""
  balanced = THETA.copy()
  balanced[4] = balanced[3] * LENGTHS[0] / LENGTHS[1]
  fit = fit_lateral(steers(theta=balanced), VEHICLE, EXACT_STD, "paper", "linear")
  np.testing.assert_allclose(fit.values, balanced[3:], rtol=0.02)
  assert abs(fit.printed_error_percent) < 0.5
  skewed = THETA.copy()
  skewed[4] = 1.6 * balanced[4]
  fit = fit_lateral(steers(theta=skewed), VEHICLE, EXACT_STD, "paper", "linear")
  assert abs(fit.values[1] / skewed[4] - 1.0) > 0.1
  exact = fit_lateral(steers(theta=skewed), VEHICLE, EXACT_STD, "exact", "linear")
  np.testing.assert_allclose(exact.values, skewed[3:], rtol=5e-3)
  printed = kinematics.steering_per_lateral_acceleration_as_printed(exact.speed, *LENGTHS, *exact.values)
  expected = 100.0 * (printed / exact.steering_per_accel - 1.0)
  np.testing.assert_allclose(exact.printed_error_percent, expected, rtol=1e-3)
  assert exact.printed_error_percent > 5.0


def test_mirrored_steps_give_the_same_tyres():
  centred = dataclasses.replace(_measured(), imu_y=0.0)
  left = fit_lateral(steers(vehicle=centred), centred, EXACT_STD, "exact", "linear")
  right = steers({role: tuple(-d for d in levels) for role, levels in DEGREES.items()}, vehicle=centred)
  np.testing.assert_allclose(fit_lateral(right, centred, EXACT_STD, "exact", "linear").values, left.values, rtol=1e-6)


@dataclasses.dataclass(frozen=True)
class _Numbers:
  mass: float
  yaw_inertia: float
  cg_to_front: float
  cg_to_rear: float
  wheel_radius: float
  gear_ratio: float
  max_steering: float
  imu_x: float
  imu_y: float


def _measured():
  return _Numbers(**{field.name: getattr(VEHICLE, field.name) for field in dataclasses.fields(_Numbers)})


def test_a_badly_measured_car_widens_the_deviations():
  rough = {**EXACT_STD, "yaw_inertia": 0.003, "cg_to_front": 0.002, "cg_to_rear": 0.002}
  narrow, wide = (fit_lateral(steers(noise=0.3), VEHICLE, std, "exact", "linear") for std in (EXACT_STD, rough))
  assert wide.covariance[0][0] > 4.0 * narrow.covariance[0][0]


def test_biases_of_the_sensors_are_taken_off():
  shifted = []
  for run in steers():
    columns = {name: run[name].value for name in run.channels}
    columns["accel_y"] = columns["accel_y"] + 0.08
    columns["yaw_rate"] = columns["yaw_rate"] - 0.02
    time = run["motor_speed"].time
    shifted.append(Recording.from_columns(run.name, time, columns, role=run.role, manoeuvre=run.manoeuvre))
  fits = [fit_lateral(r, VEHICLE, EXACT_STD, "exact", "linear") for r in (steers(), shifted)]
  np.testing.assert_allclose(fits[0].values, fits[1].values, rtol=1e-9)


@pytest.mark.parametrize("channels", [("motor_speed", "yaw_rate"), ("motor_speed", "accel_y"), ("speed", "yaw_rate")])
def test_one_lateral_channel_is_enough(channels):
  fit = fit_lateral(steers(channels=channels), VEHICLE, EXACT_STD, "exact", "linear")
  np.testing.assert_allclose(fit.values, TRUTH, rtol=0.05)


def test_refusals_say_what_is_missing():
  with pytest.raises(NotIdentifiable, match="two angles or more"):
    fit_lateral(steers({"identify": (9.0,)}), VEHICLE, EXACT_STD, "exact", "lagged")
  with pytest.raises(NotIdentifiable, match="needs accel_y; use steady_state='exact'"):
    fit_lateral(steers(channels=("motor_speed", "yaw_rate")), VEHICLE, EXACT_STD, "paper", "linear")


# -- turning losses ------------------------------------------------------------------------------


def test_turning_losses_are_recovered_and_leave_the_understeer_gradient_alone():
  losses = TurningLosses(steering=0.7, drag=400.0)
  turns = [t for t in find_turns(steers(losses=losses, duration=6.0), VEHICLE) if t.step.role == "identify"]
  steady = fit_steady_turns(turns, VEHICLE, EXACT_STD | {"wheel_radius": 1e-9}, with_loss=True)
  np.testing.assert_allclose(steady.gradient, GRADIENT, atol=6e-5)
  np.testing.assert_allclose(steady.loss, losses.steering, rtol=0.03)
  drag, std = turning_drag(turns, THETA[:3], VEHICLE)
  np.testing.assert_allclose(drag, losses.drag, rtol=0.15)
  assert std < 0.15 * drag
  plain = fit_steady_turns([t for t in find_turns(steers(), VEHICLE)], VEHICLE, EXACT_STD, with_loss=True)
  assert abs(plain.loss) < 0.02
  assert np.isnan(turning_drag(turns[:2], THETA[:3], VEHICLE)[0])


# -- the lagged transient ------------------------------------------------------------------------

NUMBERS = {name: getattr(VEHICLE, name) for name in ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "imu_x")}
LAGGED = NUMBERS | {
  "cornering_stiffness_front": TRUTH[0],
  "understeer_gradient": GRADIENT,
  "friction_coefficient": 0.95,
  "servo_time": 0.006,
  "relaxation_length": 0.009,
  "carcass_time": 0.0015,
}


def commanded(degrees, rows=transient.BEFORE + transient.AFTER):
  """Steering commands (S, T) of slewed steps, and speeds."""
  angle = np.deg2rad(np.array(degrees))[:, None]
  ramp = np.clip((np.arange(rows) - transient.BEFORE + 1) * 3.0 * PERIOD, 0.0, None)
  return np.sign(angle) * np.minimum(ramp, np.abs(angle)), np.full((len(degrees), rows), 1.5)


def column(numbers):
  return {name: np.array([value]) for name, value in numbers.items()}


def test_without_lag_and_saturation_the_response_is_the_linear_bicycle():
  steering, speed = commanded([2.0, -5.0])
  quick = LAGGED | {"friction_coefficient": 1e4, "servo_time": 0.0015, "relaxation_length": 0.002, "carcass_time": 0.0}
  delays = 0.0015 + 0.002 / 1.5
  responses = transient.responses(column(quick), 0.01 * steering, speed)["yaw_rate"][0]
  car = SingleTrackCar(
    1.0, 1.0, 0.0, *TRUTH, *(NUMBERS[n] for n in ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear")), 1.0
  )
  exact = np.zeros((2, steering.shape[1], 2))
  for k in range(steering.shape[1] - 1):
    go = lateral_transition(speed[:, k], 0.0 * speed[:, k], 0.01 * steering[:, k], PERIOD, car)
    exact[:, k + 1] = np.einsum("sij,sj->si", go.flow, exact[:, k]) + go.forced
  late = np.array([np.interp(np.arange(45) - delays / PERIOD, np.arange(45), row) for row in exact[..., 1]])
  np.testing.assert_allclose(responses, late, atol=0.06 * np.abs(exact[..., 1]).max())
  np.testing.assert_allclose(responses[:, -1], exact[:, -1, 1], rtol=1e-3)


def test_rear_stiffness_is_the_inverse_of_the_understeer_gradient():
  rear = transient.rear_stiffness(TRUTH[0], GRADIENT, VEHICLE.mass, *LENGTHS)
  np.testing.assert_allclose(rear, TRUTH[1], rtol=1e-12)


def test_brush_force_is_linear_at_first_and_ends_at_its_peak():
  force = transient.brush_force(np.array([-1e-3, 1e-3, 30.0, 300.0, -3e4]), np.array(30.0))
  np.testing.assert_allclose(force, [1e-3, -1e-3, -10.0, -10.0, 10.0], rtol=1e-4)


def transients(noise, seed, numbers=LAGGED):
  steering, speed = commanded(DEGREES["identify"])
  clean = transient.responses(column(numbers), steering, speed)
  rng, size = np.random.default_rng(seed), {"yaw_rate": 0.006, "accel_y": 0.06}
  measured = {n: v[0] + noise * size[n] * rng.standard_normal(v[0].shape) for n, v in clean.items()}
  return transient.Transients(steering, speed, measured, size)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_lagged_fit_recovers_stiffness_under_saturation_and_lag(seed):
  unknowns = transient.unknowns(NUMBERS, {name: 1e-6 for name in NUMBERS}, GRADIENT, 1e-7)
  fit = transient.fit_transients(transients(1.0, seed), unknowns)
  score = (np.log(fit.stiffness) - np.log(TRUTH)) / np.sqrt(np.diag(fit.covariance))
  assert np.abs(score).max() < 3.0
  assert np.sqrt(fit.covariance[0, 0]) < 0.15
  assert 0.7 < fit.chi_squared < 1.3
  assert fit.without.shape == (5, 2)


def test_given_numbers_are_not_bent_but_their_deviation_is_passed_on():
  rough = {name: 0.05 * abs(value) for name, value in NUMBERS.items()}
  exact = {name: 1e-6 for name in NUMBERS}
  fits = [
    transient.fit_transients(transients(1.0, 0), transient.unknowns(NUMBERS, std, GRADIENT, 1e-7))
    for std in (exact, rough)
  ]
  assert all(fits[1].values[name] == NUMBERS[name] for name in NUMBERS)
  assert fits[1].covariance[1, 1] > 2.0 * fits[0].covariance[1, 1]


def test_leaving_a_run_out_is_predicted_by_one_newton_step():
  """The last run was made by other tyres; without it the estimate moves."""
  data = transients(1.0, 5)
  other = transients(1.0, 5, LAGGED | {"cornering_stiffness_front": 1.2 * TRUTH[0]})
  mixed = {name: np.concatenate([values[:4], other.measured[name][4:]]) for name, values in data.measured.items()}
  unknowns = transient.unknowns(NUMBERS, {name: 1e-6 for name in NUMBERS}, GRADIENT, 1e-7)
  full = transient.fit_transients(dataclasses.replace(data, measured=mixed), unknowns)
  fewer = transient.Transients(
    data.steering[:4], data.speed[:4], {name: values[:4] for name, values in mixed.items()}, data.noise
  )
  moved = np.log(transient.fit_transients(fewer, unknowns).stiffness) - np.log(full.stiffness)
  np.testing.assert_allclose(full.without[4], moved, atol=0.4 * np.abs(moved).max())


def test_session_with_lags_is_identified_better_by_the_lagged_transient():
  """The linear transient misses the stiffness by more than the lagged one does."""
  steering, _ = commanded(DEGREES["identify"], 300)
  speed = np.full(steering.shape, 1.5)
  clean = transient.responses(column(LAGGED), np.roll(steering, 90, axis=1) * (np.arange(300) >= 99), speed)
  runs = []
  for k, degrees in enumerate(DEGREES["identify"]):
    columns = {name: values[0, k] for name, values in clean.items()}
    columns |= {
      "motor_voltage": np.full(300, 1.0),
      "steering_command": (np.roll(steering, 90, axis=1) * (np.arange(300) >= 99))[k],
      "motor_speed": speed[k] / (VEHICLE.gear_ratio * VEHICLE.wheel_radius),
    }
    runs.append(Recording.from_columns(f"steer_{degrees}", PERIOD * np.arange(300), columns, manoeuvre="steering_step"))
  level = dataclasses.replace(_measured(), imu_y=0.0)
  fits = {t: fit_lateral(runs, level, EXACT_STD, "exact", t) for t in ("lagged", "linear")}
  misses = {name: abs(fit.values[0] / TRUTH[0] - 1.0) for name, fit in fits.items()}
  assert misses["lagged"] < 0.1
  assert misses["lagged"] < misses["linear"]


def test_session_helper_holds_both_kinds():
  assert {r.manoeuvre for r in session().recordings} == {"voltage_step", "steering_step"}
