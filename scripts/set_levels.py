"""Fit the weights that decide to kept evidence of several generators, and write levels.toml.

qcar-twin set-levels --answers out/first out/second out/exam_slipx --out out/levels.toml
"""

import dataclasses
from pathlib import Path

from calibration.concealed.campaign.set_levels import fitted_weights, judged_apart, with_weights, write_weights
from calibration.concealed.examination.kept import kept_in, write_kept
from calibration.diagnosis.decision.levels import FILE, read_levels
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Fit to all cases, every generator counted alike, and judge each generator by weights fitted to the others."""

  answers: tuple[Path, ...]
  """Folders of campaigns, archives, folders of closed exams; none of their cases may count when the outcome is
  measured."""
  out: Path
  """File of levels to write, complete, with the fitted weights."""
  archive: Path | None = None
  """File to keep the cases' evidence in; give it as --answers to fit to the same again."""
  levels: Path = FILE
  """File of levels whose other numbers are taken over; the installed one by default."""


def main(config: Config) -> str:
  """Fit, write and judge; returns the weights and the counts as Markdown."""
  cases, levels = kept_in(config.answers), read_levels(config.levels)
  weights = fitted_weights(cases, levels)
  if config.archive is not None:
    write_kept(config.archive, cases)
  sources = " ".join(map(str, config.answers if config.archive is None else [config.archive]))
  write_text(config.out, config.levels.read_text(encoding="utf-8"))
  command = f"qcar-twin set-levels --answers {sources} --out {config.out.name}"
  generators = ", ".join(sorted({case.generator for case in cases}))
  source = f"logistic regression on {len(cases)} cases of {generators}, every generator counted alike"
  write_weights(weights, source, command, config.out)
  fitted = f"{len(cases)} cases: " + ", ".join(f"{name} {value:.3f}" for name, value in weights.items())
  said = f"{fitted}\n\n{judged_apart(cases, levels, with_weights(levels, weights))}"
  print(f"{said}written to {config.out}")
  return said


if __name__ == "__main__":
  run_script()
