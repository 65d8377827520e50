"""What the car's libraries have beside the car: control laws, signals, timing, plots."""

import math

import numpy as np
import pytest

from qcar_twin.onboard.libraries.control import PID, QCarDriveController, StanleyController
from qcar_twin.onboard.libraries.signals import Calculus
from tests.qcar_twin.onboard.rig import drive_text

LINE = np.array([[0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0]])
RING = np.stack([np.cos(np.linspace(0.0, math.tau, 73))[:-1], np.sin(np.linspace(0.0, math.tau, 73))[:-1]])


def test_a_pid_follows_its_law_and_does_not_wind_up():
  law = PID(Kp=2.0, Ki=1.0, Kd=0.5, uLimits=(-1.0, 1.0))
  assert law.update(0.3, 0.0, 0.1) == pytest.approx(2.0 * 0.3 + 0.1 * 0.3)
  assert law.update(0.3, 0.2, 0.1) == pytest.approx(2.0 * 0.1 + (0.03 + 0.01) - 0.5 * 0.2 / 0.1)
  for _ in range(1000):
    assert law.update(9.0, 0.2, 0.1) == 1.0
  assert law.update(0.1, 0.2, 0.1) < 0.0, "a second above the reference is enough after a long stretch at the limit"
  law.reset()
  assert law.update(0.3, 0.0, 0.1) == pytest.approx(0.63)


@pytest.mark.parametrize(
  ("place", "heading", "steering"),
  [((0.5, 0.0), 0.0, 0.0), ((0.5, -0.1), 0.0, math.atan(0.1)), ((0.5, 0.1), 0.0, -math.atan(0.1)),
   ((0.5, 0.0), 0.2, -0.2), ((0.5, 0.0), math.tau - 0.2, 0.2), ((0.5, -5.0), 0.0, math.pi / 6)],
)  # fmt: skip
def test_the_stanley_law_steers_back_to_the_path(place, heading, steering):
  law = StanleyController(LINE, k=1.0)
  assert law.update(place, heading, 1.0) == pytest.approx(steering)
  np.testing.assert_allclose(law.p_ref, [0.5, 0.0], atol=1e-12)


def test_a_path_ends_or_begins_again():
  law, ring = StanleyController(LINE, cyclic=False), StanleyController(RING, cyclic=True)
  for x in np.arange(0.0, 3.2, 0.1):
    assert not law.pathComplete or x > 2.95
    law.update((x, 0.0), 0.0, 1.0)
  assert law.pathComplete
  for angle in np.linspace(0.0, 3.0 * math.tau, 500):
    steering = ring.update((math.cos(angle), math.sin(angle)), angle + math.pi / 2.0, 1.0)
    assert abs(steering) < 0.1, "a car on the ring and along it steers by the corners of the path alone"
  assert not ring.pathComplete
  with pytest.raises(ValueError, match=r"waypoints must be \(2, N\)"):
    StanleyController(LINE.T)


def test_the_drive_controller_stops_the_car_at_the_end_of_the_path():
  law = QCarDriveController(LINE, cyclic=False)
  assert law.update((0.5, 0.0), 0.0, 0.2, 0.5, 0.01) == (pytest.approx(0.1 * 0.3 + 0.003), 0.0)
  law.update((3.5, 0.0), 0.0, 0.5, 0.5, 0.01)
  duty, steering = law.update((3.5, 0.2), 0.1, 0.5, 0.5, 0.01)
  assert duty < 0.0 and steering == 0.0 and law.steeringController.pathComplete
  law.reset()
  assert not law.steeringController.pathComplete


def test_derivatives_and_integrals_are_sent_samples():
  slope, area = Calculus().differentiator(0.1), Calculus().integrator_variable(0.1, 2.0)
  assert (next(slope), next(area)) == (0.0, 2.0)
  assert [slope.send(x) for x in (0.1, 0.4)] == pytest.approx([1.0, 3.0])
  assert [area.send((x, dt)) for x, dt in ((1.0, 0.1), (2.0, 0.5))] == pytest.approx([2.1, 3.1])


def test_a_script_of_a_course_runs_with_plots_timer_and_controller(tmp_path, capsys):
  text = """
    import numpy as np, pyqtgraph as pg
    from pyqtgraph.Qt import QtCore
    import pal.resources.images as images
    from pal.products.qcar import QCar, QCarGPS
    from pal.utilities.scope import MultiScope
    from pal.utilities.timing import Timer
    from hal.content.qcar_functions import QCarDriveController, QCarEKF
    scope = MultiScope(rows=1, cols=2)
    scope.axes[4].images[0].setImage(image=images.SDCS_CITYSCAPE)
    arrow = pg.ArrowItem(angle=180, brush=[1, 2, 3], pen=QtCore.Qt.blue)
    scope.axes[4].plot.addItem(arrow)
    path = np.array([[0.0, 6.0], [0.0, 0.0]])
    law, ekf = QCarDriveController(path, cyclic=False), QCarEKF(x_0=[0, 0, 0])
    timer, scans = Timer(sampleRate=50, totalTime=4), 0
    with QCar(readMode=0) as car, QCarGPS(initialPose=[0, 0.2, 0], attach_lidar=False) as gps:
      while timer.check():
        car.read()
        new = gps.readGPS()
        pose = np.array([*gps.position[:2], gps.orientation[2]]) if new else None
        ekf.update([car.motorTach, 0.0], timer.get_sample_time(), pose, car.gyroscope[2])
        duty, steering = law.update(ekf.x_hat[:2, 0], ekf.x_hat[2, 0], car.motorTach, 0.8, timer.get_sample_time())
        car.write(duty, steering)
        scans += gps.readLidar()
        arrow.setPos(*ekf.x_hat[:2, 0])
        timer.sleep()
    print(round(timer.get_current_time(), 1), scans, bool(abs(ekf.x_hat[1, 0]) < 0.1), bool(0.6 < car.motorTach < 1.0))
  """
  driven = drive_text(tmp_path, text)
  assert driven.error == ""
  assert capsys.readouterr().out == "4.0 40 True True\n"


def test_a_name_that_is_not_offered_comes_from_the_owner_s_module_of_that_name(tmp_path, capsys):
  folder = tmp_path / "library" / "pal" / "utilities"
  folder.mkdir(parents=True)
  (folder / "math.py").write_text(
    "def wrap_to_pi(angle): return 'own'\ndef find_overlap(): return 12\n", encoding="utf-8"
  )
  text = "from pal.utilities.math import find_overlap, wrap_to_pi\nprint(find_overlap(), wrap_to_pi(0.0))\n"
  assert drive_text(tmp_path, text, library=tmp_path / "library").error == ""
  assert capsys.readouterr().out == "12 0.0\n"
  assert "no 'find_overlap' in pal.utilities.math" in drive_text(tmp_path, text).error


def test_what_is_refused_here_comes_from_the_owner_s_library_where_it_can_do_without_the_car(tmp_path, capsys):
  for module, text in (
    ("hal/products/mats.py", "from pal.utilities.math import wrap_to_pi\nclass SDCSRoadMap:\n  nodes = 24\n"),
    ("pal/products/qcar.py", "from quanser.hardware import HIL\nclass QCarCameras:\n  pass\n"),
  ):
    path = tmp_path / "library" / module
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
  text = "from hal.products.mats import *\nprint(SDCSRoadMap().nodes)\nfrom pal.products.qcar import QCarCameras\n"
  driven = drive_text(tmp_path, text, library=tmp_path / "library")
  assert (driven.error, capsys.readouterr().out) == ("", "24\n")
  driven = drive_text(tmp_path, f"{text}QCarCameras()\n", library=tmp_path / "library")
  assert "QCarCameras: the simulated car has no camera" in driven.error
