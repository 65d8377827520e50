"""Drive a session in the independent car, with concealed effects where asked for.

Writes it as a data set, and its truth sealed in another folder.

qcar-twin make-session --out OUT --seed 1 --effect steering_delay --size 1.0 --truth-out TRUTH
"""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from calibration.concealed.laboratory.seal import seal
from calibration.concealed.laboratory.written import save, save_clean
from calibration.concealed.proving_ground import EFFECTS, Spec
from calibration.concealed.proving_ground.long_session import make_long_session
from calibration.concealed.proving_ground.session import draw_effect
from calibration.concealed.second_car import SECOND_EFFECTS, draw_second_effect, make_second_session
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet


@dataclass(frozen=True)
class Config:
  """A session of an independent car."""

  out: Path
  """Folder of the data set."""
  seed: int = 0
  """Seed of the car, the driver and the noise."""
  car: Literal["first", "second"] = "first"
  """Independent car to drive; the second is of another structure and slower to simulate."""
  effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
  """Id of a concealed effect; repeatable. 'list' prints all ids."""
  size: tyro.conf.UseAppendAction[tuple[float, ...]] = ()
  """Size of each effect in multiples of its typical magnitude; 1 where not given."""
  draw: bool = False
  """Conceal one effect drawn at random; it is printed nowhere and stands only in the truth."""
  design: str = "lab"
  """Session design: lab (5 min of driving), compact (2 min), paper; of other cars wild, vesc_duty, _current, _speed."""
  sessions: int = 1
  """Number of sessions of the same car, one after the other, for a long log."""
  noise_level: float = 1.0
  """Factor on sensor and process noise, dimensionless."""
  truth_out: Path | None = None
  """Folder of the sealed truth; OUT_truth next to the data set where not given."""
  clean: bool = False
  """Write the true states next to the truth too, as clean.npz."""
  packed: bool = False
  """Compress and encode the truth, so that nobody reads it by accident."""
  name: str = "session"
  """Name of the data set."""
  quick: bool = False
  """Use the compact design whatever --design says."""


def chosen(config: Config) -> tuple[tuple[str, float], ...]:
  """The effects asked for, each with its size. Raises ValueError when there are more sizes than effects."""
  if len(config.size) > len(config.effect):
    raise ValueError(f"{len(config.size)} sizes for {len(config.effect)} effects: give each --size after its --effect")
  sizes = (*config.size, *[1.0] * (len(config.effect) - len(config.size)))
  draw = draw_second_effect if config.car == "second" else draw_effect
  drawn = (draw(np.random.default_rng(secrets.randbits(64))),) if config.draw else ()
  return (*zip(config.effect, sizes, strict=True), *drawn)


def main(config: Config) -> DataSet | None:
  """Make, write and read back one session, and print what was written; or list the effects."""
  if "list" in config.effect:
    kinds = SECOND_EFFECTS if config.car == "second" else EFFECTS
    print(
      "\n".join(
        f"{name:24s}{kind.subsystem:12s}{kind.typical:8.3g} {kind.unit}" for name, kind in sorted(kinds.items())
      )
    )
    return None
  if config.car == "second" and config.sessions > 1:
    raise ValueError(f"the second car drives one session at a time, not {config.sessions}: leave --sessions out")
  began = time.perf_counter()
  design = "compact" if config.quick else config.design
  if config.car == "second":
    session = make_second_session(config.seed, chosen(config), design, config.noise_level)
  else:
    session = make_long_session(Spec(config.seed, chosen(config), design, config.noise_level), config.sessions)
  took = time.perf_counter() - began
  truth = config.truth_out or config.out.with_name(config.out.name + "_truth")
  mark = seal(session.truth, config.out, truth, config.packed)
  save(session, config.out, config.name, mark)
  if config.clean:
    save_clean(session, truth)
  data = DataSet.load(config.out)
  driven = sum(recording.duration for recording in data.recordings)
  print(f"{len(data.recordings)} recordings, {driven:.0f} s of driving, made in {took:.1f} s: {config.out}")
  print(f"truth committed to as {mark}")
  return data


if __name__ == "__main__":
  run_script()
