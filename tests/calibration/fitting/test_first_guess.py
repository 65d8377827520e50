"""First values of the drive: read off runs of a motor whose three numbers are known."""

import numpy as np
import pytest

from calibration.fitting.first_guess import _with_shown_lag, first_guess
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.parameters import base_parameters, drive_response, informed
from qcar_twin.vehicle.vehicle import Vehicle

NUMBERS = {
  "mass": 2.7, "yaw_inertia": 0.030, "cg_to_front": 0.124, "cg_to_rear": 0.132, "wheel_radius": 0.033,
  "gear_ratio": 0.0953668, "max_steering": 0.5236, "imu_x": 0.0, "imu_y": 0.0, "track_width": 0.17, "cg_height": 0.045,
}  # fmt: skip
VEHICLE = Vehicle.from_dataset(NUMBERS, {})
P1, P2, P3 = 620.0, 1.8, 115.0  # rad/s^2/V, 1/s, rad/s^2
TIME = np.arange(0.0, 12.0, 0.01)
STEP = np.where(TIME < 1.0, 0.0, np.where(TIME < 8.0, 2.0, 0.0))


def run(volts: np.ndarray, lost: float = 0.0, name: str = "run", begin: float = 0.0) -> Recording:
  """The motor's speed by small explicit steps, from `begin` s on; `lost` is a further friction, rad/s^2."""
  omega = np.zeros(TIME.size)
  for k in range(1, TIME.size):
    free = omega[k - 1] + 0.01 * (P1 * volts[k - 1] - P2 * omega[k - 1])
    omega[k] = max(free - 0.01 * (P3 + lost), 0.0)
  kept = begin <= TIME
  streams = {"motor_voltage": Stream(TIME[kept], volts[kept]), "motor_speed": Stream(TIME[kept], omega[kept])}
  return Recording(name, streams)


def numbers(*runs: Recording) -> np.ndarray:
  """P1, P2, P3 of the guess."""
  guess, names = first_guess(runs, VEHICLE), ("torque_per_volt", "motor_damping", "driveline_friction")
  return np.array([guess[name].nominal for name in names]) / VEHICLE.drive_inertia


def test_a_motor_of_known_numbers_is_read_off_its_step():
  assert numbers(run(STEP), run(1.5 * STEP)) == pytest.approx([P1, P2, P3], rel=0.03)


def test_long_steady_driving_with_a_loss_of_its_own_does_not_shrink_all_three():
  """Forty runs in turns of all widths that cost speed beside one step straight ahead: the scale comes from the step."""
  rng = np.random.default_rng(1)
  drawn = zip(rng.uniform(1.5, 3.5, 40), rng.uniform(0.0, 700.0, 40), strict=True)
  turns = [run(np.full(TIME.size, v), lost, f"turn_{i}", 4.0) for i, (v, lost) in enumerate(drawn)]
  p1, p2, p3 = numbers(run(STEP), *turns)
  assert 0.5 * P1 < p1 < 1.5 * P1 and 0.5 * P2 < p2 < 2.0 * P2 and P3 < p3 < P3 + 700.0


@pytest.mark.parametrize("lag", [0.0, 0.004])
def test_a_drive_that_answers_within_a_sample_has_a_usual_time_constant(lag):
  """At 10 Hz only the speed that goes with a voltage shows: no inertia at all fits as well, and is no motor."""
  time, rng = np.arange(0.0, 60.0, 0.1), np.random.default_rng(3)
  volts = np.repeat(rng.uniform(1.0, 3.0, 75), 8)
  omega = (P1 * volts - P3) / P2 + (rng.normal(0.0, 2.0, time.size) if not lag else 0.0)
  omega -= lag * np.gradient(omega, time)
  streams = {"motor_voltage": Stream(time, volts), "motor_speed": Stream(time, omega)}
  p1, p2, p3 = numbers(Recording("run", streams))
  usual = drive_response(VEHICLE, base_parameters(VEHICLE))
  assert p2 == pytest.approx(usual[1], rel=1e-6)
  assert p1 / p2 == pytest.approx(P1 / P2, rel=0.05) and p3 / p2 == pytest.approx(P3 / P2, rel=0.15)


@pytest.mark.parametrize("b", [0.0, 1e-17, 1e-3])
def test_a_lag_that_is_not_told_never_makes_a_motor_without_inertia(b):
  usual = (600.0, 2.0, 100.0)
  p1, p2, _ = _with_shown_lag((np.array([1e-17, b, 0.03]), 1e-6), usual, 0.1)
  assert p1 == pytest.approx(2.0 / b if b > 1e-6 else 600.0) and p2 == pytest.approx(b * p1)


@pytest.mark.parametrize("volts", [0.0, 2.0])
def test_without_any_change_of_speed_the_nominal_values_stay(volts: float):
  still = Recording("still", {"motor_voltage": Stream(TIME, np.full(TIME.size, volts)),
                              "motor_speed": Stream(TIME, np.full(TIME.size, 500.0 * (volts > 0)))})  # fmt: skip
  assert first_guess([still], VEHICLE).nominal == pytest.approx(base_parameters(VEHICLE).nominal)


def test_a_first_guess_bounds_nothing():
  base = base_parameters(VEHICLE)
  for factor in (1e-6, 1e6):
    guess = informed(base, {p.name: factor * p.nominal for p in base if p.nominal > 0.0 and p.std is None})
    for old, new in zip(base, guess, strict=True):
      assert new.lower <= old.lower and new.upper >= old.upper


def test_steps_of_a_loss_that_is_guessed_to_be_nothing_stay_as_they_were():
  base = base_parameters(VEHICLE)
  guess = informed(base, {"motor_damping": 1e-12, "driveline_friction": 1e-12, "torque_per_volt": 1e-12})
  assert guess["motor_damping"].scale == base["motor_damping"].scale
  assert guess["driveline_friction"].scale == base["driveline_friction"].scale
  assert guess["torque_per_volt"].scale < 1e-6 * base["torque_per_volt"].scale
