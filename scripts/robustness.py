"""Drive policies and tuned controllers with other noise, speeds and linkages.

qcar-twin robustness --out OUT [--policy agents/data/policy] [--streams 24]
"""

import dataclasses
from pathlib import Path
from typing import Literal

from agents.control.controllers import FILE
from agents.learning.policy_file import SHIPPED
from agents.studies.comparison import Kept, drivers_of, identities
from agents.studies.robustness import NOMINAL, as_json, circumstances, drive_all, in_markdown
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.command_line import run_script

ON_PLANT = FILE.with_name("controllers_reduced.toml")

POSITIVE = ("streams",)

KEPT = "circumstances that were driven stay in --out, the same command goes on with the others"


@dataclasses.dataclass(frozen=True)
class Config:
  """Paired differences on O, infinity and C, in one circumstance after another; what was driven is not driven again."""

  out: Path
  """Folder for robustness.json and robustness.md."""
  policy: tuple[Path, ...] = (SHIPPED,)
  """Policy folders or zips of stable-baselines3; everybody is compared with the first."""
  controllers: tuple[Path, ...] = (ON_PLANT,)
  """TOML files of tuned controllers."""
  names: tuple[str, ...] = ("lq_ed", "linear_rate")
  """Controllers of these files that drive."""
  plant: Literal["mujoco", "reduced", "bicycle"] = "reduced"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, or the bicycle."""
  streams: int = 24
  """Streams of sensor noise on each of O, infinity and C."""
  unknown: tuple[str, ...] = ()
  """Parameters that the filter estimates as extra states, as `track` does; none: the plain filter."""
  only: tuple[str, ...] = ()
  """Circumstances whose names begin with one of these; all where empty."""
  quick: bool = False
  """Two streams, the nominal drive and another filter noise."""


def main(config: Config) -> None:
  """Drive, write, print the table."""
  only = ("filter noise x 2",) if config.quick else config.only
  asked = {k: v for k, v in circumstances().items() if not only or k == NOMINAL or k.startswith(only)}
  drivers = lambda speed: drivers_of(config.policy, config.controllers, config.names, speed)
  streams = 2 if config.quick else config.streams
  said = lambda text: print(text, flush=True)
  config.out.mkdir(parents=True, exist_ok=True)
  about = [
    config.plant,
    streams,
    list(config.unknown),
    list(drivers(0.5)),
    identities(config.policy, config.controllers),
  ]
  kept = Kept(config.out / "driven.json", about)
  results = drive_all(drivers, config.plant, streams, asked, said, config.unknown, kept)
  write_json(config.out / "robustness.json", as_json(results))
  write_text(config.out / "robustness.md", table := in_markdown(results))
  print(table)


if __name__ == "__main__":
  run_script()
