"""Writes logs of a car of another size: python -m tests.sizes.logs --size full --out out/full [--commonroad]."""

import argparse
from pathlib import Path

from tests.sizes.cars import CARS, drive
from tests.sizes.commonroad import drive_multi_body


def write(size: str, folder: Path, count: int = 6, seconds: float = 20.0, commonroad: bool = False) -> Path:
  """`count` CSV files of `seconds` of driving each; the full-size one by CommonRoad's multi-body model if asked."""
  folder.mkdir(parents=True, exist_ok=True)
  car, driven = CARS[size], drive_multi_body if commonroad else drive
  for k in range(count):
    columns = driven(car, seconds, k)
    rows = [",".join(columns), *(",".join(f"{x:.7g}" for x in row) for row in zip(*columns.values(), strict=True))]
    (folder / f"drive_{k}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
  return folder


if __name__ == "__main__":
  parser = argparse.ArgumentParser()
  parser.add_argument("--size", choices=list(CARS), required=True)
  parser.add_argument("--out", type=Path, required=True)
  parser.add_argument("--count", type=int, default=6)
  parser.add_argument("--seconds", type=float, default=20.0)
  parser.add_argument("--commonroad", action="store_true")
  given = parser.parse_args()
  print(write(given.size, given.out, given.count, given.seconds, given.commonroad))
