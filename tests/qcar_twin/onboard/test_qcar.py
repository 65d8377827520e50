"""The QCar's interface: what is written acts, what is read is what the sensors said, at the time they said it."""

import math

import numpy as np
import pytest

from qcar_twin.onboard.pose_filter import QCarEKF
from qcar_twin.onboard.qcar import MOST_STEERING
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.onboard.rig import by_hand, drive_text

VEHICLE = Vehicle()


def test_throttle_is_a_duty_of_the_pack_and_both_commands_are_clipped(tmp_path):
  plant, commands = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar(pwmLimit=0.2, steeringBias=0.01)
    for throttle, steering in ((0.1, 0.2), (0.9, -2.0), (-0.9, 2.0)):
      car.write(throttle, steering)
      time.sleep(0.05)
  """
  assert drive_text(tmp_path, text, plant).error == ""
  supply = VEHICLE.supply_voltage
  assert commands[2] == pytest.approx([0.1 * supply, 0.21])
  assert commands[7] == pytest.approx([0.2 * supply, 0.01 - MOST_STEERING])
  assert commands[12] == pytest.approx([-0.2 * supply, 0.01 + MOST_STEERING])


def test_a_command_within_a_period_acts_for_its_share_of_it(tmp_path):
  plant, commands = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar()
    time.sleep(0.0125)
    car.write(0.1, 0.0)
    time.sleep(0.005)
    car.write(0.2, 0.0)
    time.sleep(0.02)
  """
  drive_text(tmp_path, text, plant)
  supply = VEHICLE.supply_voltage
  assert np.array(commands)[:, 0] == pytest.approx([0.0, supply * (0.5 * 0.1 + 0.25 * 0.2), 0.2 * supply], rel=1e-3)


def test_terminate_brings_the_car_to_rest_and_what_is_written_then_is_ignored(tmp_path):
  plant, commands = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar
    with QCar() as car:
      car.write(0.1, 0.1)
      time.sleep(0.05)
    car.write(0.2, 0.2)
    car.read()
    time.sleep(0.05)
  """
  assert drive_text(tmp_path, text, plant).error == ""
  assert commands[0] == pytest.approx([1.2, 0.1]) and commands[-1] == pytest.approx([0.0, 0.0])


def test_what_is_read_is_the_car(tmp_path):
  plant, _ = by_hand()
  text = """
    import numpy as np
    import time
    from pal.products.qcar import QCar, IS_PHYSICAL_QCAR
    assert IS_PHYSICAL_QCAR
    car = QCar(readMode=0)
    car.write(0.1, 0.3)
    time.sleep(1.0)
    car.read()
    turned = car.motorEncoder[0] * car.PIN_TO_SPUR_RATIO / (4 * car.ENCODER_COUNTS_PER_REV) * 2 * np.pi
    assert abs(car.motorTach - 1.2) < 0.02, car.motorTach
    assert abs(turned * car.WHEEL_RADIUS - 1.2) < 0.03, turned * car.WHEEL_RADIUS
    assert abs(car.gyroscope[2] - 0.3) < 0.1 and car.gyroscope.shape == (3,)
    assert car.accelerometer.shape == (3,) and abs(car.accelerometer[2] - 9.81) < 1e-6
    assert car.batteryVoltage == 12.0 and np.isfinite(car.motorCurrent)
  """
  assert drive_text(tmp_path, text, plant).error == ""


def test_a_task_keeps_the_rate_and_an_immediate_reading_does_not(tmp_path):
  text = """
    import sys, time
    from pal.products.qcar import QCar
    car = QCar(readMode=int(sys.argv[1]), frequency=50)
    t0 = time.perf_counter()
    for _ in range(101):
      car.read()
      car.write(0.0, 0.0)
    print(round(time.perf_counter() - t0, 3))
  """
  assert drive_text(tmp_path, text, arguments=("1",)).seconds == pytest.approx(2.0, abs=0.01)
  assert drive_text(tmp_path, text, arguments=("0",)).seconds < 0.2


def test_a_loop_slower_than_its_task_reads_old_samples_and_is_told_so(tmp_path):
  plant, _ = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar(readMode=1, frequency=100)
    car.write(0.1, 0.0)
    for _ in range(100):
      car.read()
      time.sleep(0.02)
    old = car.motorEncoder[0]
    now = QCar(readMode=0)
    now.read()
    assert now.motorEncoder[0] > 1.8 * old, (old, now.motorEncoder[0])
  """
  driven = drive_text(tmp_path, text, plant)
  assert driven.error == ""
  assert "readings were up to 0.99 s old" in driven.notes[0] and "lower frequency, or use readMode=0" in driven.notes[0]


def test_the_pose_starts_where_the_script_says_and_comes_late_ten_times_a_second(tmp_path):
  plant, _ = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar, QCarGPS
    with QCar(readMode=1, frequency=100) as car, QCarGPS(initialPose=[2.0, -1.0, 3.1]) as gps:
      assert list(gps.position[:2]) == [2.0, -1.0]
      car.write(0.1, 0.0)
      new = 0
      for _ in range(301):
        car.read()
        new += gps.readGPS()
      assert 25 <= new <= 31, new
      gone = 2.0 - gps.position[0]
      assert 3.2 < gone < 3.65, gone
      assert abs(gps.orientation[2]) <= 3.1416
      again = QCarGPS(initialPose=[0, 0, 0])
      while not again.readGPS(): time.sleep(0.01)
      assert max(abs(again.position[:2])) < 0.3, again.position
  """
  assert drive_text(tmp_path, text, plant).error == ""


def test_the_lidar_sees_the_wall_ahead_at_pi(tmp_path):
  plant, _ = by_hand()
  text = """
    import numpy as np
    from pal.products.qcar import QCar, QCarLidar
    car, lidar = QCar(), QCarLidar(numMeasurements=720)
    car.write(0.1, 0.0)
    for _ in range(11):
      lidar.read()
    ahead = lidar.distances[np.abs(lidar.angles - np.pi) < 0.05]
    behind = lidar.distances[lidar.angles < 0.05]
    right = lidar.distances[np.abs(lidar.angles - 1.5 * np.pi) < 0.02]
    assert abs(np.median(ahead) - 2.8) < 0.1 and abs(np.median(behind) - 5.2) < 0.1, (ahead, behind)
    assert abs(np.median(right) - 4.0) < 0.1
  """
  assert drive_text(tmp_path, text, plant).error == ""


@pytest.mark.parametrize(
  ("call", "said"),
  [
    ("QCar().write(float('nan'), 0)", "throttle must be one finite number, not nan"),
    ("QCar().write(0, [0.1, 0.2])", "steering must be one finite number"),
    ("QCar(readMode=2)", "readMode is 0 \\(at once\\) or 1 \\(a task\\), not 2"),
    ("QCar(frequency=0)", "frequency is in Hz"),
  ],
)
def test_what_no_car_can_do_is_refused(tmp_path, call, said):
  driven = drive_text(tmp_path, f"from pal.products.qcar import QCar\n{call}")
  with pytest.raises(AssertionError, match=said):
    raise AssertionError(driven.error)


def test_the_filter_follows_a_circle_and_takes_in_poses():
  ekf, speed, steering, dt = QCarEKF([0.0, 0.0, 0.0]), 0.8, 0.2, 0.01
  rate = speed * math.tan(steering) / ekf.L
  for _ in range(500):
    ekf.update([speed, steering], dt, None, rate)
  yaw = rate * 5.0
  truth = np.array([speed / rate * math.sin(yaw), speed / rate * (1.0 - math.cos(yaw))])
  assert np.hypot(*(ekf.x_hat[:2, 0] - truth)) < 0.02
  before = np.trace(ekf.P)
  for _ in range(20):
    ekf.update([0.0, 0.0], dt, np.array([1.0, 2.0, -3.1]), 0.0)
  assert ekf.x_hat[:, 0] == pytest.approx([1.0, 2.0, -3.1], abs=0.02) and np.trace(ekf.P) < before


def test_the_filter_without_a_gyro_turns_by_the_steering():
  ekf = QCarEKF([0.0, 0.0, 0.0])
  ekf.update([1.0, 0.1], 0.1)
  assert ekf.x_hat[2, 0] == pytest.approx(0.1 * math.tan(0.1) / ekf.L)


def test_times_of_a_loop_are_no_round_numbers(tmp_path, capsys):
  """On a car nobody ever sees t == 1.0: scripts that leave that instant out (t < 1, t > 1) are right."""
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar(readMode=1, frequency=100)
    begun, round_ones = time.time(), 0
    for _ in range(300):
      car.read()
      round_ones += time.time() - begun in (1.0, 2.0)
    print(round_ones)
  """
  assert drive_text(tmp_path, text).error == ""
  assert capsys.readouterr().out == "0\n"
