"""Print the sealed truth of a session, after checking it against the published hash.

qcar-twin unseal --truth data/sample_truth --data data/sample
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from calibration.concealed.laboratory.seal import COMMITMENT, unseal
from qcar_twin.command_line import run_script


@dataclass(frozen=True)
class Config:
  """The truth to open."""

  truth: Path = Path("data/sample_truth")
  """Folder of the sealed truth."""
  data: Path = Path("data/sample")
  """Folder of the data set that published the hash."""


def main(config: Config) -> dict:
  """Check, print and return the truth."""
  truth = unseal(config.truth, (config.data / COMMITMENT).read_text())
  print(json.dumps(truth, indent=1))
  return truth


if __name__ == "__main__":
  run_script()
