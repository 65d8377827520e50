"""Decide kept evidence again under several rules, without driving anything.

qcar-twin replay --answers out/campaign
"""

import dataclasses
from pathlib import Path

from calibration.concealed.campaign.replay import kept_cases, read_results, table
from calibration.concealed.examination.sealed import PLAN, opened
from calibration.diagnosis.decision.levels import FILE, read_levels
from qcar_twin.command_line import run_script

TYPICAL = FILE.with_name("typical.toml")


@dataclasses.dataclass(frozen=True)
class Config:
  """Count what rules name on kept cases: sessions without an effect that are accused, effects that are named."""

  answers: tuple[Path, ...]
  """Folders of campaigns, archives of their answers, folders of closed exams."""
  rules: tuple[Path, ...] = (FILE, TYPICAL)
  """Files of levels to compare; the installed one and the one before it by default."""


def main(config: Config) -> str:
  """Replay; returns the counts as Markdown."""
  results = [r for a in config.answers for r in (opened(a) if (a / PLAN).is_file() else read_results(a))]
  cases = list(kept_cases(results))
  if not cases:
    raise ValueError(
      f"{', '.join(map(str, config.answers))}: no case kept its evidence; run the campaign again, as this version does"
    )
  said = table(cases, {file.stem: read_levels(file) for file in config.rules})
  print(f"{len(cases)} cases\n{said}")
  return said


if __name__ == "__main__":
  run_script()
