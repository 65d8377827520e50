"""`qcar-twin drive`: a script on the twin, on the reduced car and on the independent one, and what is printed."""

import pytest

from calibration.log_check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from scripts import drive
from scripts.__main__ import main
from tests.qcar_twin.onboard.rig import SCRIPTS


def test_it_drives_and_records(tmp_path, capsys):
  words = ["drive", str(SCRIPTS / "steps.py"), "--plant", "reduced", "--effect", "steering_delay=0.05"]
  assert main([*words, "--record", str(tmp_path / "set"), "--", "1", "8"]) == 0
  said = capsys.readouterr().out
  assert "801 samples" in said and "drove 8.0 s in" in said and "steps (identify)" in said
  assert DataSet.load(tmp_path / "set")["steps"].duration == pytest.approx(8.0, abs=0.02)


def test_a_script_that_fails_keeps_its_recording(tmp_path, capsys):
  script = tmp_path / "fails.py"
  script.write_text("import time\nfrom pal.products.qcar import QCar\nQCar()\ntime.sleep(2)\nraise OSError('gone')\n")
  assert main(["drive", str(script), "--plant", "reduced", "--record", str(tmp_path / "set")]) == 1
  said = capsys.readouterr().err
  assert "OSError: gone" in said and "fails.py ended early after 2.0 s" in said and "fails (identify)" in said
  assert "line 5" in said and "runpy" not in said
  assert DataSet.load(tmp_path / "set").recordings


def test_the_independent_car_is_driven_behind_the_same_interface(tmp_path):
  config = drive.Config(
    SCRIPTS / "steps.py", ("1", "3"), plant="proving_ground", effect=("steering_delay=1",), record=tmp_path / "set"
  )
  assert drive.main(config).seconds == pytest.approx(3.0, abs=0.02)
  assert DataSet.load(tmp_path / "set").vehicle["motor_constant"] > 0.0


def test_a_twin_and_the_independent_car_are_not_driven_at_once(tmp_path):
  with pytest.raises(ValueError, match="the independent car is no twin: leave --twin out"):
    drive.main(drive.Config(SCRIPTS / "steps.py", twin=tmp_path / "twin.toml", plant="proving_ground"))


def test_a_car_that_takes_a_current_cannot_be_driven_by_a_duty():
  from qcar_twin.onboard.plants import OnboardPlant
  from qcar_twin.vehicle.vehicle import Vehicle

  vehicle = Vehicle(drive="current")
  with pytest.raises(ValueError, match="a QCar's throttle is a duty"):
    OnboardPlant(lambda start: None, vehicle, {}, {}, "x")  # type: ignore[arg-type, return-value]


def test_a_size_that_is_no_number_is_said(tmp_path):
  config = drive.Config(SCRIPTS / "steps.py", plant="proving_ground", effect=("steering_delay=much",))
  with pytest.raises(ValueError, match="'steering_delay=much' needs a number of typical sizes: steering_delay=1"):
    drive.main(config)


def test_a_data_set_without_the_script_is_said_before_anything_is_driven(tmp_path):
  with pytest.raises(RecordingError, match="no such folder"):
    drive.main(drive.Config(tmp_path / "absent.py", plant="reduced", compare=tmp_path / "nowhere"))


def test_a_slalom_at_a_held_speed_is_a_sound_log(tmp_path):
  script = tmp_path / "slalom.py"
  script.write_text(SLALOM)
  drive.main(drive.Config(script, plant="reduced", record=tmp_path / "set"))
  check = check_log(DataSet.load(tmp_path / "set"))
  assert not check.of("spoils")  # the accelerometer feels the turning, and hardly any change of speed


SLALOM = """
import math, time
from pal.products.qcar import QCar

with QCar(readMode=1, frequency=100) as car:
  begun, total = time.time(), 0.0
  while (now := time.time() - begun) < 40.0:
    car.read()
    total += 0.003 * (1.0 - car.motorTach)
    car.write(0.1 * (1.0 - car.motorTach) + total, 0.25 * math.sin(2.5 * now))
"""
