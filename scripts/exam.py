"""Sit a sealed exam on cars of a published simulator; stops and resumes. Extra `exam`.

qcar-twin exam --generator slipx --cases 60 --out out/exam_slipx --workers 2
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from joblib import delayed

from calibration.concealed.campaign.run import all_answered
from calibration.concealed.exam.cases import draw_cases
from calibration.concealed.examination.commit import code_of, committed
from calibration.concealed.examination.page import verdict, write_exam
from calibration.concealed.examination.run import attempt
from calibration.concealed.examination.sealed import UNSEALED, Plan, begin, close, is_answered, opened
from calibration.progress import counted
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel

KEPT = "cases that were answered stay in --out, the same command goes on with the others"


@dataclass(frozen=True)
class Config:
  """Diagnose concealed cases of a published simulator, and score the answers."""

  out: Path
  """Folder of the exam; cases that were answered stay, the same command goes on with the others."""
  generator: str = "slipx"
  """Car that is driven: slipx, commonroad, commonroad_full or exudyn; its package comes with the extra `exam`."""
  cases: int = 60
  """Number of cases: 40 without an effect to 40 with one, 15 with two and 10 outside the catalogue."""
  workers: int = 1
  """Number of cases at a time, one core each."""
  unsealed: bool = False
  """A trial: sit it with changed files, too. Its cases are drawn from --trial, and the page says so."""
  trial: str = "trial"
  """Text that an unsealed exam's cases are drawn from."""
  close: bool = False
  """Answer nothing more: close the exam with the cases that are answered, and score them."""


def main(config: Config) -> Path:
  """Answer what is missing, close, open the truths, write the page; returns its path."""
  digest, code = (config.trial + UNSEALED, code_of()) if config.unsealed else (committed(), "")
  plan = begin(config.out, Plan(config.generator, digest, not config.unsealed, config.cases, code=code))
  cases = draw_cases(plan.generator, plan.commit, plan.cases)
  todo = [] if plan.closed or config.close else [c for c in cases if not is_answered(config.out, c.name)]
  jobs = in_parallel([delayed(attempt)(case, config.out) for case in todo], config.workers)
  all_answered([line for _, line in counted(jobs, len(todo), "case")], config.out / "answers")
  plan = close(config.out, [case.name for case in cases], early=config.close)
  results = opened(config.out)
  report = write_exam(config.out, plan, results, f"{plan.command} --out out/{config.out.name}")
  print(f"{verdict(results)}\nkey of the truths: {plan.key}\nreport: {report}")
  return report


if __name__ == "__main__":
  run_script()
