"""Logs of a car of another size, and its measured numbers in a data set that `new` has drafted:

python -m tests.sizes.logs --size full --out out/logs --commonroad
python -m tests.sizes.logs --size full --steps out/steps
python -m tests.sizes.logs --size full --measured out/full
"""

import argparse
import re
from collections.abc import Mapping
from pathlib import Path

from tests.sizes.cars import CARS, Array, drive, step
from tests.sizes.commonroad import drive_multi_body


def write(size: str, folder: Path, count: int = 6, seconds: float = 20.0, commonroad: bool = False) -> Path:
  """`count` CSV files of `seconds` of driving each; the full-size one by CommonRoad's multi-body model if asked."""
  folder.mkdir(parents=True, exist_ok=True)
  car, driven = CARS[size], drive_multi_body if commonroad else drive
  for k in range(count):
    _save(driven(car, seconds, k), folder / f"drive_{k}.csv")
  return folder


# what a scale, a ruler and a data sheet err by, as a share; a servo's time constant is seldom known better
_ERRS = {"mass": 0.01, "yaw_inertia": 0.1, "cg_to_front": 0.01, "cg_to_rear": 0.01, "track_width": 0.01,
         "cg_height": 0.1, "wheel_radius": 0.01, "servo_time_constant": 0.5}  # fmt: skip


def write_steps(size: str, folder: Path) -> Path:
  """Seven steps of the drive and seven of the steering, as the identification needs them."""
  folder.mkdir(parents=True, exist_ok=True)
  car = CARS[size]
  for k, share in enumerate((0.6, 0.8, 1.0, 1.2, 0.7, 0.9, 1.1)):
    _save(drive(car, 0.0, k, step(car, share, 0.0)), folder / f"drive_step_{k}.csv")
  for k, accel_y in enumerate((1.4, 1.8, 2.2, 2.6, 3.0, 1.6, 2.0)):
    _save(drive(car, 0.0, 50 + k, step(car, 1.0, accel_y)), folder / f"steering_step_{k}.csv")
  return folder


def _save(columns: Mapping[str, Array], path: Path) -> None:
  rows = [",".join(columns), *(",".join(f"{x:.7g}" for x in row) for row in zip(*columns.values(), strict=True))]
  path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_measured(size: str, dataset: Path) -> None:
  """Put the car's published numbers in place of the guesses in [vehicle] of dataset.toml, and say which files are steps
  of the steering."""
  path, numbers = dataset / "dataset.toml", CARS[size].measured
  before, _, rest = path.read_text(encoding="utf-8").partition("[vehicle]\n")
  guessed, _, after = rest.partition("[channels]\n")
  lines = [line for line in guessed.splitlines() if line.startswith("drive = ")]
  lines += [f"{name} = {value!r}" for name, value in numbers.items()]
  lines += ["", "[vehicle.std]", *(f"{name} = {share * numbers[name]:.6g}" for name, share in _ERRS.items()), "", ""]
  after = re.sub(r'(file = "steering_step.*"\n)', r'\1manoeuvre = "steering_step"\n', after)
  path.write_text(before + "[vehicle]\n" + "\n".join(lines) + "[channels]\n" + after, encoding="utf-8")


if __name__ == "__main__":
  parser = argparse.ArgumentParser()
  parser.add_argument("--size", choices=list(CARS), required=True)
  parser.add_argument("--out", type=Path)
  parser.add_argument("--steps", type=Path)
  parser.add_argument("--measured", type=Path)
  parser.add_argument("--count", type=int, default=6)
  parser.add_argument("--seconds", type=float, default=20.0)
  parser.add_argument("--commonroad", action="store_true")
  given = parser.parse_args()
  if given.out:
    print(write(given.size, given.out, given.count, given.seconds, given.commonroad))
  if given.steps:
    print(write_steps(given.size, given.steps))
  if given.measured:
    write_measured(given.size, given.measured)
