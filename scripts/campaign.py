"""Run and score a campaign of concealed cases, which may be stopped and continued.

qcar-twin campaign --out out/campaign --seed 1
"""

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Literal

from joblib import delayed

from calibration.concealed.campaign.archive import pack, read_answer, unpack
from calibration.concealed.campaign.cases import draw_cases, draw_second_cases, draw_wild_cases
from calibration.concealed.campaign.page import campaign_page, wild_page
from calibration.concealed.campaign.report import write_campaign, write_wild
from calibration.concealed.campaign.run import all_answered, attempt
from calibration.concealed.campaign.score import score_table
from calibration.concealed.campaign.wild_score import wild_table
from calibration.progress import counted
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel

KEPT = "cases that were answered stay in --out, the same command goes on with the others"


@dataclasses.dataclass(frozen=True)
class Config:
  """Make, diagnose and score sessions of the independent car."""

  out: Path
  """Folder for the answers and report.html; answers that are there are kept."""
  seed: int = 1
  """Seed that determines every case."""
  nulls: int = 30
  """Number of sessions without any effect."""
  singles: int = 40
  """Number of sessions with one effect of the catalogue."""
  pairs: int = 12
  """Number of sessions with two effects of the catalogue."""
  outside: int = 6
  """Number of sessions with an effect that the catalogue does not have."""
  wild: int = 0
  """Number of sessions of cars far from the QCar, with four to eight effects at once."""
  car: Literal["first", "second"] = "first"
  """Independent car to drive; the second, of another structure, has sessions with no effect and with one only."""
  design: Literal["compact", "lab", "paper"] = "compact"
  """Session design: compact (about 2 min of driving), lab (5 min) or paper."""
  jobs: int = 2
  """Number of cases that run in parallel, one core each."""
  ray: bool = False
  """Run on the Ray cluster at hand, not in local processes; its computers have to see --out."""
  archive: Path | None = None
  """File with all answers: those in it are unpacked first, and it is replaced at the end."""
  page: Path | None = None
  """Markdown page to write; a picture of the confusions goes next to it, except for wild cases."""
  score_only: bool = False
  """Run nothing and score the answers that are there."""
  quick: bool = False
  """Run one case of each kind."""
  engine: Literal["search", "curves"] = "search"
  """Method that answers: 'search' (docs/guide/diagnosis.md), or 'curves' for wild cases
  (docs/guide/curves.md)."""


def main(config: Config) -> str:
  """Run what is missing; returns the score as a Markdown table."""
  counts = (1, 1, 1, 1) if config.quick else (config.nulls, config.singles, config.pairs, config.outside)
  if config.car == "second":
    cases = draw_second_cases(config.seed, *counts[:2], design=config.design)
  else:
    cases = draw_cases(config.seed, *counts, design=config.design) + draw_wild_cases(config.seed, config.wild)
  if config.archive and config.archive.is_file():
    unpack(config.archive, config.out)
  # kinds take turns, so that a campaign that is stopped early has seen all of them
  of_kind = Counter(case.kind for case in cases)
  cases.sort(key=lambda case: (int(case.name.split("_")[1]) / of_kind[case.kind], case.name))
  todo = [] if config.score_only else [c for c in cases if not (config.out / f"{c.name}.json").is_file()]
  jobs = in_parallel([delayed(attempt)(c, config.out, engine=config.engine) for c in todo], config.jobs, config.ray)
  said = [line for _, line in counted(jobs, len(todo), "case")]
  answers = [config.out / f"{c.name}.json" for c in cases]
  results = [read_answer(path) for path in answers if path.is_file()]
  wild = config.engine == "curves"
  table = wild_table(results) if wild else score_table(results)
  write_text(config.out / "score.md", table)
  if config.archive:
    pack(config.out, config.archive)
  usual, options = Config(config.out), ("car", "nulls", "singles", "pairs", "outside", "wild", "design", "engine")
  other = [f" --{n} {getattr(config, n)}" for n in options if getattr(config, n) != getattr(usual, n)]
  command = f"qcar-twin campaign --out out/{config.out.name} --seed {config.seed}{''.join(other)}"
  report = (write_wild if wild else write_campaign)(config.out, results, len(cases), command)
  if config.page and wild:
    write_text(config.page, wild_page(results, len(cases), command))
  elif config.page:
    write_text(config.page, campaign_page(results, len(cases), command, config.page.with_suffix(".png")))
  print(f"{table}report: {report}")
  all_answered(said, config.out)
  return table


if __name__ == "__main__":
  run_script()
