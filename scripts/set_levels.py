"""Fit the weights that decide to kept evidence of several generators, and write levels.toml.

qcar-twin set-levels --answers out/first out/second out/exam_slipx --out out/levels.toml
qcar-twin set-levels --stated out/first out/second --out out/levels.toml
"""

import dataclasses
from pathlib import Path

from calibration.concealed.campaign.replay import read_results
from calibration.concealed.campaign.set_levels import (
  fitted_weights,
  held_out_weight,
  judged_apart,
  stated,
  with_weights,
  write_weights,
)
from calibration.concealed.examination.kept import kept_in, write_kept
from calibration.diagnosis.decision.levels import FILE, read_levels
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Fit to all cases, every generator counted alike, and judge each generator by weights fitted to the others."""

  out: Path
  """File of levels to write, complete, with the fitted weights."""
  answers: tuple[Path, ...] = ()
  """Folders of campaigns, archives, folders of closed exams; none of their cases may count when the outcome is
  measured."""
  stated: tuple[Path, ...] = ()
  """Folders or archives of campaigns, to whose claims the weight of held-out recordings is fitted."""
  archive: Path | None = None
  """File to keep the cases' evidence in; give it as --answers to fit to the same again."""
  levels: Path = FILE
  """File of levels whose other numbers are taken over; the installed one by default."""


def main(config: Config) -> str:
  """Fit, write and judge; returns the weights and the counts as Markdown.

  Raises:
    ValueError: nothing to fit to.
  """
  if not config.answers and not config.stated:
    raise ValueError("nothing to fit to; give --answers, --stated or both")
  write_text(config.out, config.levels.read_text(encoding="utf-8"))
  said = [_names(config) if config.answers else "", _held(config) if config.stated else ""]
  told = "\n".join(filter(None, said))
  print(f"{told}written to {config.out}")
  return told


def _held(config: Config) -> str:
  levels = read_levels(config.levels)
  seen = stated((result for source in config.stated for result in read_results(source)), levels)
  weight, wrong = held_out_weight(seen), int((~seen.right).sum())
  source = f"logistic regression on {len(seen.right)} answers that claim one name, {wrong} of them a wrong one"
  command = f"qcar-twin set-levels --stated {' '.join(map(str, config.stated))} --out {config.out.name}"
  write_weights({"held": weight}, source, command, config.out)
  return f"{len(seen.right)} answers, {wrong} wrong: held {weight:.3f}\n"


def _names(config: Config) -> str:
  cases, levels = kept_in(config.answers), read_levels(config.levels)
  weights = fitted_weights(cases, levels)
  if config.archive is not None:
    write_kept(config.archive, cases)
  sources = " ".join(map(str, config.answers if config.archive is None else [config.archive]))
  command = f"qcar-twin set-levels --answers {sources} --out {config.out.name}"
  generators = ", ".join(sorted({case.generator for case in cases}))
  source = f"logistic regression on {len(cases)} cases of {generators}, every generator counted alike"
  write_weights(weights, source, command, config.out)
  fitted = f"{len(cases)} cases: " + ", ".join(f"{name} {value:.3f}" for name, value in weights.items())
  return f"{fitted}\n\n{judged_apart(cases, levels, with_weights(levels, weights))}"


if __name__ == "__main__":
  run_script()
