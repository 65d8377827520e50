"""Calibrate and cross-validate real cars and fresh sessions, and write one page.

qcar-twin benchmark-calibration --work out/calibrations --out docs/results/calibration.md
"""

import dataclasses
from pathlib import Path

from calibration.concealed.benchmarks.calibration import judge, match, page, to_judge, to_match
from calibration.concealed.laboratory.seal import seal
from calibration.concealed.laboratory.written import save
from calibration.concealed.proving_ground import make_session
from calibration.progress import StageLine, joined, within
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

REAL = Path("../shared/data")
PAGE = """# Calibration of the twin

`qcar-twin benchmark-calibration --work out/calibrations --out docs/results/calibration.md`;
for one data set alone `qcar-twin calibrate --dataset DIR --against identified` (or `recordings`)
and `qcar-twin cross-validate --dataset DIR --twin FILE`.

Step responses are compared as the paper does: root mean square over the response, per cent of the steady value, mean
over the steps. `identify` are the steps the twin was fitted to, `validate` those it was not. Sessions `session_...` are
drives of the independent car without any concealed effect, with the seed of their name; `sample` conceals one.

On recordings, the calibration's errors are those of stretches of 6 s at most; the cross-validation starts both models
again every 0.5 s, every 2 s, or never. Displacements are over 1 s, over 0.4 s in windows of 0.5 s. Where a data set is
long, the fit sees 420 s of it, half of them spread evenly and half chosen for what they tell.
`before` is the twin at the data set's nominal numbers. What `[vehicle]` does not say comes from
`assets/qcar.toml`, and the drive there is itself a fit to straight runs of a QCar: on qcar_ground the error
before is no measure of an uninformed start.

Hold-out recordings are not used on this page. Those of qcar_ground and dart were looked at while the identification
and the first guess of the drive were developed, so for that part they are not untouched; no figure below rests on them.

{tables}"""
KEPT = "data sets that were finished stay in --work, the same command goes on with the others"

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Results that are in `work` are kept. Delete a folder there to make it again."""

  out: Path
  """Markdown file to write."""
  work: Path = Path("out/calibrations")
  """Folder of the results, one folder per data set."""
  datasets: tuple[Path, ...] = (REAL / "qcar_ground", REAL / "dart", REAL / "cpm_ucar")
  """Data sets of real cars: calibrated against their recordings and cross-validated."""
  steps: tuple[Path, ...] = (Path("data/sample"),)
  """Data sets whose identified model the twin is fitted to."""
  seed: int = 501
  """Seed of the first fresh session; the others follow it."""
  sessions: int = 2
  """Number of fresh sessions to whose identified model the twin is fitted."""
  quick: bool = False
  """Fresh sessions of two minutes and no real cars."""
  threads: int = 0
  """Threads of the simulation; 0 uses every core. Results do not depend on it."""


def fresh(config: Config, seed: int) -> Path:
  """Folder of a session without effects, made where it isn't there yet."""
  folder = config.work / f"session_{seed}" / "data"
  if not (folder / "dataset.toml").is_file():
    session = make_session(seed, (), "compact" if config.quick else "lab")
    save(session, folder, f"session_{seed}", seal(session.truth, folder, folder.with_name("truth")))
  return folder


def main(config: Config) -> str:
  """Run what is missing and write the page; returns it."""
  work, threads = config.work, config.threads
  sessions = {f"session_{seed}": seed for seed in range(config.seed, config.seed + config.sessions)}
  matched = [*(path.name for path in config.steps), *sessions]
  recorded = {path.name: path for path in (() if config.quick else config.datasets)}
  stages = [to_match(f"{name}, steps", work / name / "identified") for name in matched]
  stages += [to_judge(f"{name}, recordings", work / name) for name in recorded]
  with StageLine(joined(*stages)) as progress:
    data = {path.name: path for path in config.steps} | {n: fresh(config, seed) for n, seed in sessions.items()}
    steps = {n: match(data[n], work / n / "identified", threads, within(f"{n}, steps", progress)) for n in matched}
    records = [judge(path, work / n, threads, within(f"{n}, recordings", progress)) for n, path in recorded.items()]
  text = PAGE.format(tables=page(records, steps))
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
