"""Numbers that the filter is told, or estimates beside the motion: linkage, delay, gyro, encoder, drive."""

import copy
import dataclasses

import numpy as np
import pytest

from qcar_twin.estimation import kalman, models
from qcar_twin.estimation.models import BETA, R, V
from qcar_twin.estimation.settings import PRIORS, FilterSettings
from qcar_twin.estimation.state import FilterState
from qcar_twin.estimation.unknowns import TYRES, Unknowns
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, journey, position_errors, rms, run

GAIN, OFFSET, BIAS, SPEED_SCALE, DRIVE_SCALE = 0.9, 0.02, 0.03, 1.04, 0.9
TRUTH = {
  "steering_gain": GAIN,
  "steering_offset": OFFSET,
  "yaw_rate_bias": BIAS,
  "speed_scale": SPEED_SCALE,
  "drive_scale": DRIVE_SCALE,
}
ALL = FilterSettings().estimating(*PRIORS)


def strange(seconds=20.0, seed=0, delays=(0, 0)):
  """A drive of a car whose numbers are those of TRUTH, and whose voltage and steering act some periods late."""
  trip = journey(seconds, seed=seed)
  given = trip.commands[:, 0] / DRIVE_SCALE, (trip.commands[:, 1] - OFFSET) / GAIN
  early = np.stack([np.append(g[d:], np.full(d, g[-1])) for g, d in zip(given, delays, strict=True)], axis=1)
  return dataclasses.replace(trip, commands=early, speed=SPEED_SCALE * trip.speed, yaw_rate=trip.yaw_rate + BIAS)


def cars(count=6, seed=0, settings=ALL):
  """Moving cars that know their numbers wrongly, wheels turned."""
  rng = np.random.default_rng(seed)
  state = FilterState.at(rng.normal(size=(count, 3)), rng.uniform(-1.0, 1.0, count), 0.01, unknown=PRIORS.values())
  state.bicycle[:, models.BETA :] += 0.05 * rng.normal(size=(count, 7))
  state.servo_angle = rng.uniform(-0.3, 0.3, count)
  state.wheel_angle = Unknowns(CAR, settings).wheel_angle(state)
  return state


def ahead(state, voltage, settings=ALL):
  """Motion of the cars after a period, (N, 6), by the model."""
  unknowns = Unknowns(CAR, settings)
  angle, volts = unknowns.wheel_angle(state), unknowns.of(state, "drive_scale") * voltage
  return np.stack(models.bicycle_step(tuple(state.bicycle[:, :6].T), volts, angle, CAR, PERIOD, np)[0], axis=1)


def test_slopes_by_the_unknown_numbers_are_those_of_the_model():
  state, voltage = cars(), np.full(6, 1.5)
  following, h = ahead(state, voltage), 1e-6
  transition = np.tile(np.eye(11), (6, 1, 1))
  Unknowns(CAR, ALL).fill(transition, state, voltage, following[:, V])
  for name, row in ALL.rows.items():
    there, back = copy.deepcopy(state), copy.deepcopy(state)
    there.bicycle[:, row] += h
    back.bicycle[:, row] -= h
    slope = (ahead(there, voltage) - ahead(back, voltage)) / (2.0 * h)
    if name == "drive_scale":  # its second-order share in the sideslip is left out
      slope[:, BETA:] = 0.0
    np.testing.assert_allclose(transition[:, :6, row], slope, atol=2e-6, err_msg=name)


def test_what_is_considered_is_the_schmidt_filter_of_the_textbook():
  """The gyro's own number stays in all cars, what tyres could be in those no floor is sure to hold."""
  state = cars()
  root = np.random.default_rng(1).normal(size=(6, 11, 11))
  state.bicycle_covariance = root @ root.transpose(0, 2, 1)
  state.holds = np.array([True, False] * 3)
  unknowns, before = Unknowns(CAR, ALL), (state.bicycle, state.bicycle_covariance)
  column, spread = unknowns.measured(state, R)
  innovation, everywhere = np.linspace(-1.0, 1.0, 6), np.ones(6, dtype=bool)
  state.bicycle, state.bicycle_covariance = kalman.absorb(*before, column, spread + 0.1, innovation, everywhere)
  unknowns.consider(state, before, R)
  for i, holds in enumerate(state.holds):
    names = {"yaw_rate_bias"} if holds else {"yaw_rate_bias", *TYRES}
    slope = np.eye(11)[R] + np.eye(11)[ALL.rows["yaw_rate_bias"]]
    gain = column[i] / (spread[i] + 0.1) * [j not in [ALL.rows[n] for n in names] for j in range(11)]
    left = np.eye(11) - np.outer(gain, slope)
    joseph = left @ before[1][i] @ left.T + 0.1 * np.outer(gain, gain)
    np.testing.assert_allclose(state.bicycle[i], before[0][i] + gain * innovation[i], atol=1e-12)
    np.testing.assert_allclose(state.bicycle_covariance[i], joseph, atol=1e-10)


def test_a_car_that_is_pushed_harder_than_any_floor_is_sure_to_hold_teaches_no_tyres():
  state = cars()
  state.bicycle[:, V], state.wheel_angle = [0.5, 3.0, 0.5, 3.0, 0.5, 0.5], np.array([0.3] * 4 + [0.0] * 2)
  following = state.bicycle[:, V] + [0.0, 0.0, 0.001, 0.0, 0.03, 0.001]
  Unknowns(CAR, ALL).fill(np.tile(np.eye(11), (6, 1, 1)), state, np.full(6, 1.5), following)
  assert state.holds.tolist() == [True, False, True, False, False, True]


def test_numbers_that_are_known_make_the_estimate_of_an_ordinary_car():
  plain = position_errors(journey(), run(journey())[0])
  told = FilterSettings(drive_delay=0.01, steering_delay=0.03, **TRUTH)
  trip = strange(delays=(1, 3))
  after = slice(300, -5)
  assert rms(position_errors(trip, run(trip, told)[0])[after]) == pytest.approx(rms(plain[after]), rel=0.02)
  assert rms(position_errors(trip, run(trip)[0])[after]) > 2.0 * rms(plain[after])


@pytest.mark.parametrize("seed", [0, 1])
def test_numbers_that_are_unknown_are_found_to_within_their_standard_deviations(seed):
  trip = strange(40.0, seed)
  estimates, federated = run(trip, ALL)
  assert set(federated.numbers) == set(TRUTH)
  for name, (value, std) in federated.numbers.items():
    assert abs(value - TRUTH[name]) < 4.0 * std and std < 0.6 * PRIORS[name], (name, value, std)
  plain = rms(position_errors(journey(40.0, seed=seed), run(journey(40.0, seed=seed))[0])[1000:])
  assert rms(position_errors(trip, estimates)[1000:]) < 1.15 * plain


def test_late_samples_leave_what_samples_in_time_leave():
  """Commands under way and unknown numbers belong to the past that is filtered again."""
  settings, trip = dataclasses.replace(ALL, drive_delay=0.01, steering_delay=0.03), strange(6.0, delays=(1, 3))
  numbers = [run(trip, settings, latency=latency)[1] for latency in (0, 5)]
  for one in numbers:
    one.estimate(6.3)
  for name, (value, std) in numbers[0].numbers.items():
    assert numbers[1].numbers[name] == pytest.approx((value, std), abs=0.1 * std)


def test_a_bias_that_the_watch_finds_is_taken_from_the_filters_own():
  """Both see the same jump of the gyro; what is taken off it is the jump once."""
  trip = journey(30.0)
  jumped = dataclasses.replace(trip, yaw_rate=trip.yaw_rate + 0.2 * (trip.time > 10.0))
  estimates, federated = run(jumped, FilterSettings().estimating("yaw_rate_bias"))
  assert any("the gyro is taken to be off by" in text for text in estimates[-1].warnings)
  assert federated.numbers["yaw_rate_bias"][0] == pytest.approx(0.2, abs=0.01)
  assert rms(position_errors(trip, estimates)[2000:]) < 0.01


def test_what_cannot_be_estimated_is_named_with_what_was_meant():
  with pytest.raises(ValueError, match="cannot estimate 'steer_gain'; did you mean 'steering_gain'"):
    FilterSettings().estimating("steer_gain")


def test_a_twin_tells_the_filter_of_linkage_delays_and_sensors():
  values = {
    "servo_time_constant": 0.03,
    "steering_lag": 0.02,
    "steering_gain_error": -0.08,
    "steering_offset": 0.017,
    "steering_delay": 0.034,
    "wheel_radius_error": 0.25,
    "gyro_bias": 0.01,
    "imu_lever_arm_x": 0.05,
    "mass": 2.7,
  }
  settings = FilterSettings(imu_x=0.1, accel_x_bias=0.3).with_known(values)
  assert (settings.steering_gain, settings.steering_offset, settings.yaw_rate_bias) == (0.92, 0.017, 0.01)
  assert settings.delays == (0, 3) and settings.steering_lag == pytest.approx(0.054)
  assert (settings.speed_scale, settings.accel_x_bias) == (0.8, 0.3) and settings.imu_x == pytest.approx(0.15)
  assert FilterSettings().with_known({"mass": 2.7}) == FilterSettings()


def test_what_both_commands_wait_counts_in_either_delay():
  told = FilterSettings().with_known({"command_delay": 0.02, "steering_delay": 0.014})
  assert told == FilterSettings().with_known({"drive_delay": 0.02, "steering_delay": 0.034})
  sooner = FilterSettings().with_known({"command_delay": -0.01, "steering_delay": 0.03})
  assert sooner == FilterSettings().with_known({"drive_delay": 0.0, "steering_delay": 0.02})


@pytest.mark.parametrize(("layout", "share"), [("all-wheel", 0.5), ("rear", 0.0), ("front", 1.0)])
def test_a_car_tells_the_filter_which_wheels_its_encoder_sees(layout, share):
  vehicle = dataclasses.replace(Vehicle(), layout=layout, imu_x=0.1)
  settings = FilterSettings.of_vehicle(vehicle, sharing=(0.5, 0.5))
  assert (settings.front_drive_share, settings.imu_x, settings.sharing) == (share, 0.1, (0.5, 0.5))
