"""Going on from a twin: what it was fitted to is the first guess, and what it carries is in every model."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.considered import always_free, considered
from calibration.fitting.dataset_recalibration import starting_priors
from calibration.fitting.tolerances import always_fitted, sensor_error_mechanisms
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.mechanisms import catalogue, offered, select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

VEHICLE = Vehicle.load()
ALL = tuple(m for m in catalogue().values() if "voltage" in m.drives)
SENSORS = sensor_error_mechanisms(ALL)
TOLERATED = tuple(m for m in select(always_fitted("voltage")) if m not in SENSORS)
GYRO = catalogue()["gyro_bias"].sensor_errors["gyro_bias"]


@pytest.fixture(scope="module")
def repaired():
  """A twin whose steering is late by 40 ms and whose front tyres are stiffer than the car's nominal ones."""
  twin = Twin(VEHICLE, select(["steering_delay"]), threads=1)
  theta = twin.parameters.nominal
  theta[twin.parameters.index("steering_delay")] = 0.04
  theta[twin.parameters.index("cornering_stiffness_front")] *= 1.3
  return twin, theta


def test_without_a_start_every_model_has_the_base_and_the_sensors_own_errors():
  known = considered(None, None)
  assert known == offered("voltage")
  priors = starting_priors([], Twin(VEHICLE, known, threads=1), None)
  declared = {name: error for m in SENSORS for name, error in m.sensor_errors.items()}
  assert declared and all(priors[name].std == error.std for name, error in declared.items())
  assert all(always_free(m, priors) for m in SENSORS) and not any(always_free(m, priors) for m in TOLERATED)


def test_a_repaired_twin_brings_its_mechanisms_and_its_values(repaired):
  known = considered(["gyro_scale"], repaired)
  assert {m.name for m in known} == {"gyro_scale", "steering_delay", *(m.name for m in (*SENSORS, *TOLERATED))}
  priors = starting_priors([], Twin(VEHICLE, known, threads=1), repaired)
  assert priors["steering_delay"].nominal == 0.04
  nominal = repaired[0].base["cornering_stiffness_front"].nominal
  assert priors["cornering_stiffness_front"].nominal == pytest.approx(1.3 * nominal)


def test_what_was_measured_keeps_its_prior(repaired):
  twin, theta = repaired
  measured = [p for p in twin.base if p.std is not None]
  assert measured
  moved = theta.copy()
  for p in measured:
    moved[twin.parameters.index(p.name)] *= 1.2
  priors = starting_priors([], Twin(VEHICLE, considered(None, repaired), threads=1), (twin, moved))
  assert all(priors[p.name] == p for p in measured)


def gyro(*levels: float) -> list[Recording]:
  """A recording per level: two seconds at rest, in which the gyro reads it, and then a turn to the left."""
  time = np.arange(0.0, 5.0, 0.01)
  rest, noise = time < 2.0, 0.002 * np.random.default_rng(1).standard_normal(time.size)
  columns = {"motor_voltage": np.where(rest, 0.0, 2.0), "motor_speed": np.where(rest, 0.0, 500.0)}
  return [
    Recording(
      f"run_{i}", {n: Stream(time, v) for n, v in (columns | {"yaw_rate": level + noise + ~rest * 1.0}).items()}
    )
    for i, level in enumerate(levels)
  ]


def test_a_gyro_is_believed_to_read_on_what_it_read_at_rest():
  twin = Twin(VEHICLE, considered([], None), threads=1)
  steady = starting_priors(gyro(0.05, 0.05), twin, None)["gyro_bias"]
  assert steady.nominal == pytest.approx(0.05, abs=1e-3) and steady.std == pytest.approx(GYRO.wander, rel=0.01)
  wandering = starting_priors(gyro(0.04, 0.06), twin, None)["gyro_bias"]
  assert wandering.nominal == pytest.approx(0.05, abs=1e-3) and wandering.std > 0.01
  assert starting_priors(gyro(-0.3, 0.3), twin, None)["gyro_bias"].std == GYRO.std
  assert starting_priors([], twin, None)["gyro_bias"].nominal == 0.0
  assert steady.null == 0.0  # it is claimed as an error all the same


RULED = dataclasses.replace(VEHICLE, std=dict(VEHICLE.std) | {"wheel_radius": 1e-4, "imu_x": 0.003, "imu_y": 0.002})


def test_a_rulers_errors_are_free_within_three_of_its_deviations():
  twin = Twin(RULED, considered([], None), threads=1)
  priors = starting_priors([], twin, None)
  assert priors["imu_lever_arm_x"].std == 0.003 and priors["imu_lever_arm_y"].upper == pytest.approx(0.006)
  assert priors["wheel_radius_error"].lower == pytest.approx(-3e-4 / RULED.wheel_radius)
  silent = dataclasses.replace(VEHICLE, std={})
  assert "wheel_radius_error" not in starting_priors([], Twin(silent, considered([], None), threads=1), None)


def test_what_has_one_sign_is_free_to_that_side_only():
  rate = starting_priors([], Twin(RULED, considered([], None), threads=1), None)["steering_inverse_rate"]
  assert (rate.nominal, rate.lower, rate.upper) == (0.0, 0.0, pytest.approx(3.0 * rate.std))


@pytest.mark.parametrize("found, freed", [(0.005, False), (0.04, True)])
def test_a_repaired_twin_carries_only_what_is_more_than_a_rulers_error(found, freed):
  twin = Twin(RULED, considered(["imu_lever_arm"], None), threads=1)
  theta = twin.parameters.nominal
  theta[twin.parameters.index("imu_lever_arm_x")] = found
  prior = starting_priors([], Twin(RULED, considered([], (twin, theta)), threads=1), (twin, theta))["imu_lever_arm_x"]
  assert (prior.nominal == 0.04 and prior.std is None) if freed else (prior.nominal == 0.0 and prior.std == 0.003)


def test_only_named_mechanisms_are_considered_where_names_are_given():
  assert considered(["steering_lag"], None) == (catalogue()["steering_lag"], *SENSORS, *TOLERATED)


def test_a_drive_by_current_has_no_battery_and_no_warm_winding_to_allow_for():
  by = lambda drive: {m.name for m in considered([], None, drive)}
  assert by("voltage") - by("current") == {"battery_discharge", "battery_sag", "motor_heating"}
  assert by("current") < by("voltage")
