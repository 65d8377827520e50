"""Decide kept evidence again under several rules, without driving anything.

qcar-twin replay --answers out/campaign
"""

import dataclasses
from pathlib import Path

from calibration.concealed.campaign.replay import table
from calibration.concealed.examination.kept import kept_in
from calibration.diagnosis.decision.levels import FILE, read_levels
from qcar_twin.command_line import run_script


@dataclasses.dataclass(frozen=True)
class Config:
  """Count what rules name on kept cases: sessions without an effect that are accused, effects that are named."""

  answers: tuple[Path, ...]
  """Folders of campaigns, archives of their answers or of evidence, folders of closed exams."""
  rules: tuple[Path, ...] = (FILE,)
  """Files of levels to compare; the installed one by default."""


def main(config: Config) -> str:
  """Replay; returns the counts as Markdown."""
  cases = kept_in(config.answers)
  stems = [file.stem for file in config.rules]
  said = table(cases, {f.stem if stems.count(f.stem) == 1 else str(f): read_levels(f) for f in config.rules})
  print(f"{len(cases)} cases\n{said}")
  return said


if __name__ == "__main__":
  run_script()
