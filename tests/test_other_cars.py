"""Cars of another layout and drive, described by a [vehicle] table alone: logged, read, calibrated, cross-validated.

The cars are the proving ground's, F1TENTHs with a VESC: nothing in them is the twin's.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration import calibrate, cross_validate
from calibration.concealed.laboratory.written import save
from calibration.concealed.proving_ground import Car, Spec, make_sessions
from calibration.cross_validation.cross_validation import CrossValidation, find_reference
from calibration.fitting.windows import Cut
from calibration.twin_calibration.calibration import Calibration
from qcar_twin.recordings.dataset import DataSet

DRIVES = ("speed", "current")
pytestmark = pytest.mark.slow


@dataclasses.dataclass(frozen=True)
class Trial:
  """A car of the proving ground with what was made of its log."""

  car: Car
  dataset: DataSet
  calibration: Calibration
  checked: CrossValidation

  @property
  def theta(self) -> dict[str, float]:
    return self.calibration.twin.parameters.named(self.calibration.theta)

  @property
  def inertia(self) -> float:
    """Fitted, of all the motor moves, kg m^2."""
    vehicle = dataclasses.replace(
      self.calibration.twin.vehicle, mass=self.theta["mass"], rotor_inertia=self.theta["rotor_inertia"]
    )
    return vehicle.drive_inertia

  def nrmse(self, model: str, channel: str) -> float:
    """Over windows of 2 s of the recordings with role "validate"."""
    (replay,) = self.checked.replays
    return replay.scores(model)[channel].nrmse


@pytest.fixture(scope="module")
def logged():
  """Command of the drive -> the car and its session; both are driven in one simulation."""
  cars = {drive: Car.draw_f1tenth(np.random.default_rng(5), "rear", drive) for drive in DRIVES}
  sessions = make_sessions([Spec(11, (), f"vesc_{drive}", 1.0, car) for drive, car in cars.items()])
  return {drive: (car, session) for (drive, car), session in zip(cars.items(), sessions, strict=True)}


@pytest.fixture(scope="module", params=DRIVES)
def trial(request, logged, tmp_path_factory) -> Trial:
  folder: Path = tmp_path_factory.mktemp("car") / request.param
  car, session = logged[request.param]
  save(session, folder, "f1tenth", "none")
  dataset = DataSet.load(folder)
  calibration = calibrate(dataset, against="recordings", quick=True)
  reference, missing = find_reference(dataset, Cut(most=20.0))
  checked = cross_validate(dataset, calibration.twin, calibration.theta, reference, windows=(2.0,), missing=missing)
  return Trial(car, dataset, calibration, checked)


def test_the_table_is_all_it_takes(trial):
  vehicle, train = trial.calibration.twin.vehicle, trial.car.drivetrain
  assert (vehicle.layout, vehicle.drive) == ("rear", train.command)
  assert all(vehicle.motor.channel in r and "motor_voltage" not in r for r in trial.dataset.recordings)


def test_the_drive_is_recovered(trial):
  """What a command does to the car: the speed it leads to, or the acceleration."""
  theta, train = trial.theta, trial.car.drivetrain
  if train.command == "speed":  # the loop has an idea of its own of the wheels' size, which the table does not tell
    reached = (1.5 * theta["torque_per_speed"] - theta["driveline_friction"]) / theta["motor_damping"]
    assert reached == pytest.approx(1.5 * train.motor_per_speed, rel=0.02)
    assert theta["max_torque"] == pytest.approx(train.max_current * trial.car.motor_constant, rel=0.15)
  else:
    assert theta["torque_per_ampere"] / trial.inertia == pytest.approx(trial.car.linearised()["P1"], rel=0.05)


def test_the_loops_integral_part_is_recovered(trial):
  """Its rate. This car's loop stops adding up at the limit, the twin's gives way there, which costs some of it."""
  train = trial.car.drivetrain
  if train.command == "speed":
    assert trial.theta["speed_loop_integral"] == pytest.approx(train.integral / train.proportional, rel=0.2)
  else:
    assert "speed_loop_integral" not in trial.theta


def test_the_calibrated_twin_predicts_what_it_has_not_seen(trial):
  errors = trial.calibration.errors["validate"]
  assert errors["motor_speed"].after < 0.4 * errors["motor_speed"].before
  assert errors["yaw_rate"].after < 0.4 * errors["yaw_rate"].before
  assert errors["accel_y"].after < 0.7 * errors["accel_y"].before
  assert trial.nrmse("twin", "motor_speed") < 0.15 and trial.nrmse("twin", "yaw_rate") < 0.15


def test_the_twin_is_no_worse_than_the_bicycle(trial):
  assert trial.checked.reference is not None
  for channel in ("motor_speed", "accel_y"):
    assert trial.nrmse("twin", channel) < 1.1 * trial.nrmse("bicycle", channel)


def test_the_twin_turns_no_worse_than_the_bicycle(trial):
  assert trial.nrmse("twin", "yaw_rate") < 1.1 * trial.nrmse("bicycle", "yaw_rate")


def test_the_twin_is_better_than_the_bicycle_on_the_whole(trial):
  channels = ("motor_speed", "yaw_rate", "accel_y")
  ratios = [trial.nrmse("twin", c) / trial.nrmse("bicycle", c) for c in channels]
  assert np.exp(np.mean(np.log(ratios))) < 0.75


def test_what_the_drive_can_not_show_is_said_in_words(trial):
  if trial.calibration.twin.vehicle.drive == "current":
    assert "motor_current" in trial.calibration.missing and "does not settle" in trial.calibration.missing
  else:
    assert trial.calibration.identification is not None
