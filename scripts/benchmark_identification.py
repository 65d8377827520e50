"""Identify fresh sessions and compare the parameters with the truth and the paper.

qcar-twin benchmark-identification --out docs/results/identification.md
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.concealed.proving_ground import Session, Spec, make_sessions
from calibration.cross_validation.free_run import PUBLISHED, free_run
from calibration.identification.identification import identify
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.vehicle.vehicle import Vehicle

TRUTH = ("P1", "P2", "P3", "cornering_stiffness_front", "cornering_stiffness_rear")
SYMBOLS = ("P1", "P2", "P3", "C_f", "C_r")

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Five cars without any concealed effect, each driven through a lab session."""

  out: Path
  """Markdown file to write."""
  seed: int = 501
  """Seed of the first session; the others follow it."""
  sessions: int = 5
  """Number of cars."""
  design: str = "lab"
  """Session design: lab or paper."""
  quick: bool = False
  """Two cars on the paper's manoeuvres only."""


def row(session: Session) -> tuple[str, ...]:
  """One car: RMSE of validation steps, errors of the parameters in standard deviations, errors on the oval."""
  dataset = DataSet("session", session.recordings, session.vehicle, session.vehicle_std)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  identification = identify(dataset)
  scores = (identification.theta - np.array([session.truth["linearised"][name] for name in TRUTH])) / identification.std
  oval = next(r for r in dataset.recordings if r.manoeuvre == "oval")
  plain, losses = (free_run(*identification.bicycle(vehicle, losses=x), oval, vehicle).rmse for x in (False, True))
  return (
    str(session.truth["seed"]),
    f"{identification.rmse_percent('longitudinal', 'validate'):.2f}",
    f"{identification.rmse_percent('lateral', 'validate'):.2f}",
    ", ".join(f"{z:+.1f}" for z in scores),
    " / ".join(f"{plain[name]:.3f}" for name in PUBLISHED),
    " / ".join(f"{losses[name]:.3f}" for name in PUBLISHED),
  )


def main(config: Config) -> None:
  """Run it and write the table."""
  count, design = (2, "paper") if config.quick else (config.sessions, config.design)
  sessions = make_sessions([Spec(config.seed + k, (), design) for k in range(count)])
  published = " / ".join(f"{value:.3f}" for value in PUBLISHED.values())
  errors, oval = f"error / std of {', '.join(SYMBOLS)}", f"oval, plain: {' / '.join(PUBLISHED)}"
  titles = ("seed", "longitudinal [%]", "lateral [%]", errors, oval, "oval with turning losses")
  lines = [
    f"Sessions of design `{design}`, no concealed effect, seeds from {config.seed}.",
    f"The paper: 1.88 % longitudinal, 7.33 % lateral, oval {published}.",
    "",
    *markdown.table(titles, map(row, sessions)),
  ]
  text = "\n".join(lines) + "\n"
  write_text(config.out, text)
  print(text)


if __name__ == "__main__":
  run_script()
