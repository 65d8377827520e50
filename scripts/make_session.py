"""Drive a laboratory session in the independent car and write it as a data set, the truth apart and sealed.

python scripts/make_session.py --out OUT --seed 1 --effect steering_delay --size 1.0 --truth-out TRUTH
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from calibration.proving_ground import EFFECTS, make_session
from calibration.proving_ground.seal import seal
from calibration.proving_ground.session import save
from qcar_twin.dataset import DataSet


@dataclass(frozen=True)
class Config:
  """A session of the independent car."""

  out: Path
  """folder of the data set"""
  seed: int = 0
  """draws the car, the driver, the noise"""
  effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
  """id of a concealed effect; may be given several times; `list` prints them all"""
  size: tyro.conf.UseAppendAction[tuple[float, ...]] = ()
  """size of each effect in multiples of its typical magnitude (1 where not given)"""
  design: str = "lab"
  """lab (about 5 min of driving), compact (2 min) or paper"""
  noise_level: float = 1.0
  """factor on sensor and process noise"""
  truth_out: Path | None = None
  """folder of the sealed truth; OUT_truth beside the data set where not given"""
  packed: bool = False
  """compress and encode the truth, so that nobody reads it by accident"""
  name: str = "session"
  """name of the data set"""
  quick: bool = False
  """the compact design whatever `design` says"""


def main(config: Config) -> DataSet:
  """Make, write and read back one session; prints what was written."""
  if "list" in config.effect:
    print(
      "\n".join(f"{name:26s} {kind.parameter} {kind.typical:.4g} {kind.unit}" for name, kind in sorted(EFFECTS.items()))
    )
    raise SystemExit(0)
  if len(config.size) > len(config.effect):
    raise SystemExit(f"{len(config.size)} sizes for {len(config.effect)} effects: give each --size after its --effect")
  sizes = (*config.size, *[1.0] * (len(config.effect) - len(config.size)))
  began = time.perf_counter()
  effects = tuple(zip(config.effect, sizes, strict=True))
  session = make_session(config.seed, effects, "compact" if config.quick else config.design, config.noise_level)
  took = time.perf_counter() - began
  mark = seal(
    session.truth, config.out, config.truth_out or config.out.with_name(config.out.name + "_truth"), config.packed
  )
  save(session, config.out, config.name, mark)
  data = DataSet.load(config.out)
  driven = sum(recording.duration for recording in data.recordings)
  print(f"{len(data.recordings)} recordings, {driven:.0f} s of driving, made in {took:.1f} s: {config.out}")
  print(f"truth committed to as {mark}")
  return data


if __name__ == "__main__":
  main(tyro.cli(Config, description=__doc__))
