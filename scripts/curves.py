"""Fit free piecewise-linear curves in place of the twin's maps and identify their forms.

Writes twin.toml (the best of four on validation recordings), curves.json and report.html. With --compare: which
parameters differ between two data sets. With --leave-sessions-out: how well a session is predicted that took no part
in the fit. With --starts: whether fits from several starts agree.

qcar-twin curves --dataset data/sample --out out/curves
"""

import dataclasses
from pathlib import Path

from calibration.diagnosis.curves import comparison, left_out, starts
from calibration.diagnosis.curves.report.cars_page import write_comparison, write_left_out, write_starts
from calibration.diagnosis.curves.report.page import write_study
from calibration.diagnosis.curves.study import Study, sentences, study
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.progress import CURVES, StageLine
from qcar_twin.atomic_io import write_json
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.file import save_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """Free curves for drive, resistance and steering, with lags, sensor ages and trims, against four references."""

  dataset: Path
  """Folder with dataset.toml, in SI units."""
  out: Path = Path("out/curves")
  """Folder for the results."""
  most: float = LONGEST
  """Longest driving that is simulated, s."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""
  compare: Path | None = None
  """Second data set, of this car or of a similar one: report which parameters differ between the two."""
  leave_sessions_out: bool = False
  """Fit without each session in turn and predict it, with the mean trim and gain and with its own."""
  starts: int = 0
  """Number of starts of the fit of all curves; reports whether their results agree. 0 fits once."""
  plant: EngineKind = "reduced"
  """Simulator used by the fits. 'mujoco' takes many times as long as 'reduced'; errors are computed in MuJoCo
  either way."""


def main(config: Config) -> Study | None:
  """Run it, write the results, print what was found; the study, where it was one."""
  dataset = DataSet.load(config.dataset)
  if sum(map(bool, (config.compare, config.leave_sessions_out, config.starts))) > 1:
    raise ValueError("--compare, --leave-sessions-out and --starts are questions of their own: ask one at a time")
  if config.compare:
    _compare(config, dataset, DataSet.load(config.compare))
    return None
  if config.leave_sessions_out:
    _leave_out(config, dataset)
    return None
  if config.starts:
    _from_starts(config, dataset)
    return None
  with StageLine(CURVES) as progress:
    studied = study(dataset, config.most, config.threads, progress, config.plant)
  best = studied.shipped
  save_twin(config.out / "twin.toml", best.twin, best.theta, best.note, best.command_shift)
  write_json(config.out / "curves.json", studied.document())
  for line in sentences(studied):
    print(line)
  which = studied.best.replace("_", " ")
  why = "the best of four by validation" if studied.judged else "since no recordings only judge, as far as supported"
  print(f"twin, {why}, {which}: {config.out / 'twin.toml'}")
  print(f"report: {write_study(studied, config.out)}")
  return studied


def _compare(config: Config, first: DataSet, second: DataSet) -> None:
  with StageLine() as progress:
    moved = comparison.compare_cars(first, second, config.most, config.threads, progress)
  write_json(config.out / "comparison.json", [dataclasses.asdict(m) for m in moved])
  for line in comparison.sentences(moved, first.name, second.name):
    print(line)
  print(f"report: {write_comparison(moved, first.name, second.name, config.out)}")


def _leave_out(config: Config, dataset: DataSet) -> None:
  with StageLine() as progress:
    sessions = left_out.leave_sessions_out(dataset, config.most, config.threads, progress)
  write_json(config.out / "sessions.json", [dataclasses.asdict(item) for item in sessions])
  for line in left_out.sentences(sessions):
    print(line)
  print(f"report: {write_left_out(sessions, dataset.name, config.out)}")


def _from_starts(config: Config, dataset: DataSet) -> None:
  with StageLine() as progress:
    fits = starts.from_starts(dataset, config.starts, 0, config.most, config.threads, progress)
  write_json(config.out / "starts.json", [dataclasses.asdict(s) for s in fits])
  for line in starts.sentences(fits):
    print(line)
  print(f"report: {write_starts(fits, dataset.name, config.out)}")


if __name__ == "__main__":
  run_script()
