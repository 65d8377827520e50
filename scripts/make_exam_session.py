"""Drive a null session in a simulator that others wrote (extra `exam`), as a data set.

qcar-twin make-exam-session --generator slipx --seed 1 --out OUT
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calibration.concealed.exam.session import make_exam_session
from calibration.concealed.laboratory.seal import seal
from calibration.concealed.laboratory.written import save
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet


@dataclass(frozen=True)
class Config:
  """A session of a published simulator's car."""

  out: Path
  """Folder of the data set."""
  generator: str = "slipx"
  """Car that is driven: slipx, commonroad, commonroad_full or exudyn; its package comes with the extra `exam`."""
  seed: int = 0
  """Seed of the car, the driver and the noise."""
  noise_level: float = 1.0
  """Factor on the sensors' noise, dimensionless."""
  truth_out: Path | None = None
  """Folder of the sealed truth; OUT_truth next to the data set where not given."""


def main(config: Config) -> DataSet:
  """Make, write and read back one session, and print what was written."""
  session = make_exam_session(config.generator, config.seed, config.noise_level)
  mark = seal(session.truth, config.out, config.truth_out or config.out.with_name(config.out.name + "_truth"))
  save(session, config.out, f"exam_{config.generator}_{config.seed}", mark)
  data = DataSet.load(config.out)
  driven = sum(recording.duration for recording in data.recordings)
  print(f"{len(data.recordings)} recordings, {driven:.0f} s of driving: {config.out}")
  print(f"truth committed to as {mark}")
  return data


if __name__ == "__main__":
  run_script()
