"""The drive's two-stage fit: recovery from data the model made, coverage, and every way of logging."""

import numpy as np
import pytest

from calibration.identification.drive_fit import NotIdentifiable, Responses, fit_drive, motor_steps, student_widening
from qcar_twin.bicycle.single_track import motor_speed_after
from qcar_twin.plant import START
from qcar_twin.recordings.recording import Recording
from tests.calibration.identification.bicycle_rig import PERIOD, ROLLING, THETA, VOLTS, voltage_steps

TRUTH = THETA[:3]


runs = voltage_steps


def z_scores(fit):
  return (np.array(fit.values) - TRUTH) / np.sqrt(np.diag(fit.covariance))


def test_noise_free_steps_give_back_the_parameters():
  fit = fit_drive(runs(), ROLLING)
  np.testing.assert_allclose(fit.values, TRUTH, rtol=2e-4)
  np.testing.assert_allclose((fit.slope, fit.offset), (TRUTH[0] / TRUTH[1], TRUTH[2] / TRUTH[1]), rtol=2e-4)
  assert all(s.rmse_percent < 0.02 for s in fit.steps)
  assert {s.role for s in fit.steps} == {"identify", "validate"}


def test_estimates_lie_within_three_deviations_over_seeds_and_deviations_mean_something():
  scores = np.array([z_scores(fit_drive(runs(noise=3.0, seed=seed), ROLLING)) for seed in range(8)])
  assert np.abs(scores).max() < 3.0
  assert np.sqrt(np.mean(np.square(scores))) < 1.2
  narrow = np.sqrt(np.diag(fit_drive(runs(noise=3.0), ROLLING).covariance)) / TRUTH
  assert np.all(narrow < [0.02, 0.02, 0.05])


def test_runs_that_end_before_they_settle_don_t_bias_the_fit():
  """Two and a half time constants long: 8 % of the step is still to come."""
  fit = fit_drive(runs(duration=0.5 + 2.5 / TRUTH[1]), ROLLING)
  np.testing.assert_allclose(fit.values, TRUTH, rtol=0.01)


def test_only_speed_is_logged():
  fit = fit_drive(runs(channels=("speed",)), ROLLING, scale_std=0.02)
  np.testing.assert_allclose(fit.values, TRUTH, rtol=2e-4)
  assert any("no motor_speed" in note for note in fit.notes)
  assert np.sqrt(fit.covariance[0][0]) > 0.019 * TRUTH[0]  # the unknown scale reaches P1 and P3, not P2
  assert np.sqrt(fit.covariance[1][1]) < 0.01 * TRUTH[1]


def test_reverse_steps_are_the_mirror_of_forward_ones():
  backwards = runs({role: tuple(-v for v in levels) for role, levels in VOLTS.items()})
  np.testing.assert_allclose(fit_drive(backwards, ROLLING).values, fit_drive(runs(), ROLLING).values, rtol=1e-9)


def test_car_that_does_not_move_is_left_out_and_said():
  fit = fit_drive([*runs(), *runs({"identify": (0.15,)})], ROLLING)
  np.testing.assert_allclose(fit.values, TRUTH, rtol=2e-4)
  assert any("does not move in voltage_step_0.15V" in note for note in fit.notes)


def test_two_levels_are_enough_but_their_deviation_is_unknown():
  fit = fit_drive(runs({"identify": (1.0, 2.0)}), ROLLING)
  np.testing.assert_allclose(fit.values, TRUTH, rtol=1e-3)
  assert np.all(np.isnan(np.diag(fit.covariance)))
  assert any("deviations are unknown" in note for note in fit.notes)


def test_one_level_is_refused_with_the_cure():
  with pytest.raises(NotIdentifiable, match="two levels of motor_voltage or more.*Record longer voltage_step"):
    fit_drive(runs({"identify": (1.0,), "validate": (1.5,)}), ROLLING)


def test_friction_free_drive_is_not_given_negative_friction():
  slippery = THETA.copy()
  slippery[2] = 0.0
  fit = fit_drive(runs(theta=slippery, noise=1.0), ROLLING)
  assert 0.0 <= fit.values[2] < 10.0
  np.testing.assert_allclose(fit.values[0] / fit.values[1], slippery[0] / slippery[1], rtol=0.02)


@pytest.mark.parametrize("before", [0.0, 0.1, -1.0])
def test_fast_responses_equal_the_exact_motor_equation(before):
  """Through stiction (0.1 V does not move the car) and reversal (from -1 V), step by step."""
  time = PERIOD * np.arange(700)
  volts = np.where(time < 1.0, before, 1.5)
  speed = np.zeros(700)
  for k in range(699):
    speed[k + 1] = motor_speed_after(speed[k], volts[k], PERIOD, *TRUTH)
  run = Recording.from_columns("run", time, {"motor_voltage": volts, "motor_speed": speed}, manoeuvre="voltage_step")
  steps, by_speed = motor_steps([run], ROLLING)
  assert not by_speed
  step = [s for s in steps if s.level == 1.5][0]
  responses = Responses([step])
  np.testing.assert_allclose(responses.model(TRUTH)[0], responses.measured[0], atol=1.0 if before < 0 else 1e-9)


def test_widening_tends_to_one_and_grows_for_few():
  assert student_widening(2) > student_widening(4) > 1.2
  assert abs(student_widening(10000) - 1.0) < 1e-3


def test_rig_starts_in_the_contract_order():
  assert START[3] == "velocity_x"
