"""What a benchmark of fleets says of fleets whose odd car is known, drawn and driven."""

import shutil

import numpy as np
import pytest

from calibration.concealed.benchmarks import fleet as benchmark
from calibration.concealed.benchmarks.fleet import CARS, ODD, car_name, drawn_fleet, judged
from calibration.concealed.laboratory.written import Session
from calibration.fleet.logs import find_logs
from qcar_twin.recordings.recording import Recording, RecordingError
from scripts import benchmark_fleet
from tests import ROOT

GRIP = "cornering_stiffness_rear"
DRIVE = Recording.from_columns("drive", np.arange(5) / 100.0, {"motor_voltage": np.ones(5), "motor_speed": np.ones(5)})
MADE = Session((DRIVE,), {"mass": 2.7}, {}, {}, {})


def test_the_odd_car_is_found_by_what_is_odd_about_it():
  one = judged(drawn_fleet(1, odd=0.5))
  assert one.spotted and one.named and one.alone and one.anyone and one.place == 1
  assert one.of == CARS * benchmark.PARAMETERS and car_name(ODD) in one.first


def test_another_parameter_is_not_what_is_odd():
  one = judged(drawn_fleet(1, odd=0.5), odd=("p0",))
  assert one.spotted and not one.named and not one.alone and one.place > 1


def test_equal_cars_are_nobody():
  one = judged(drawn_fleet(2))
  assert one.accused == () and not (one.spotted or one.named or one.alone or one.anyone)


@pytest.fixture
def lines(monkeypatch):
  """Logs that were calibrated, which takes no time: an odd car has half of the stiffness."""
  done = []

  def scan(logs, lines, level):
    assert level == "calibrate"
    made = []
    for log in logs:
      if (log.place, lines) not in done:
        done.append((log.place, lines))
      value = 0.5 if log.car == car_name(ODD) and "odd" in str(lines) else 1.0
      made.append({"car": log.car, "day": log.day, "parameters": {GRIP: {"value": value, "std": 0.02}}})
    return made

  monkeypatch.setattr(benchmark, "scan", scan)
  return done


def test_fleets_are_driven_once_and_stand_on_the_page(lines, monkeypatch, tmp_path, capsys):
  driven = []

  def make_session(seed, effects, design, noise, car):
    driven.append((seed, car.friction))
    return MADE

  monkeypatch.setattr(benchmark, "make_session", make_session)
  config = benchmark_fleet.Config(tmp_path / "fleet.md", tmp_path / "fleets", seed=4, fleets=10, driven=1, logs=2)
  text = benchmark_fleet.main(config)
  assert f"| odd_4 | {car_name(ODD)}: {GRIP} |" in text and "| equal_4 | nobody |" in text
  assert len(driven) == len(lines) == CARS * 2 + 2  # of the fleet with an odd car that one alone
  assert len({seed for seed, _ in driven}) == CARS * 2  # the odd car's drivers are those of its place, each log another
  usual = driven[0][1]
  less = [friction for _, friction in driven if friction != usual]
  assert less == [pytest.approx(0.8 * usual)] * 2  # the odd car's two logs
  assert len(find_logs(tmp_path / "fleets" / "odd_4" / "logs")) == 2
  assert "| equal cars | 0 of 1 (0.000 to 0.975) |" in text and "less grip |  | 1 of 1 (0.025 to 1.000) |" in text
  assert "log 14 of 14" in capsys.readouterr().err
  assert benchmark_fleet.main(config) == text and len(driven) == 14


def test_a_scan_of_copies_is_timed(tmp_path):
  sample = tmp_path / "sample"
  sample.mkdir()
  for name in ("dataset.toml", "standstill.csv", "voltage_step_2V.csv"):
    shutil.copy(ROOT / "data" / "sample" / name, sample)
  one = benchmark.scanned(sample, 5)
  assert one.logs == 5 and one.refused == 0 and one.wall > 0.0 and one.processor > 0.0
  assert one.driven == pytest.approx(3 * 3.99 + 2 * 5.49, abs=0.1)
  with pytest.raises(RecordingError, match="holds no CSV file to copy"):
    benchmark.scanned(tmp_path, 5)
