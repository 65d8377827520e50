"""Drive policies and tuned controllers with the same noise, and say by how much they differ.

qcar-twin compare --out OUT [--policy agents/data/policy] [--controllers agents/data/controllers_reduced.toml]
"""

import dataclasses
import json
from pathlib import Path
from typing import Literal

from agents.control.controllers import FILE
from agents.learning.policy_file import SHIPPED
from agents.studies.comparison import Design, Kept, as_json, compare, drivers_of, identities, in_markdown
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.command_line import run_script

ON_PLANT = FILE.with_name("controllers_reduced.toml")

POSITIVE = ("speed", "streams", "tracks")

KEPT = "courses that were driven stay in --out, the same command goes on with the others"


@dataclasses.dataclass(frozen=True)
class Config:
  """Paired differences on O, infinity, C and random tracks, without (N) and with (MIS) an error of the linkage; a
  comparison that was stopped goes on."""

  out: Path
  """Folder for comparison.json and comparison.md; courses that were driven are kept in it."""
  policy: tuple[Path, ...] = (SHIPPED,)
  """Policy folders or zips of stable-baselines3; everybody is compared with the first."""
  controllers: tuple[Path, ...] = (ON_PLANT,)
  """TOML files of tuned controllers."""
  names: tuple[str, ...] = ("lq_ed", "linear_rate")
  """Controllers of these files that drive."""
  plant: Literal["mujoco", "reduced", "bicycle"] = "reduced"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, or the bicycle."""
  speed: float = 0.5
  """Reference speed, m/s."""
  streams: int = 100
  """Streams of sensor noise on each of O, infinity and C."""
  tracks: int = 20
  """Number of random tracks."""
  unknown: tuple[str, ...] = ()
  """Parameters that the filter estimates as extra states, as `track` does; none: the plain filter."""
  plain_too: bool = False
  """Everybody drives a second time, with the plain filter and the same noise of the sensors."""
  after: float = 0.0
  """Time from each start that does not count, s."""
  quick: bool = False
  """Four streams, two tracks."""


def main(config: Config) -> None:
  """Drive, write, print the tables."""
  asked = {f.name: getattr(config, f.name) for f in dataclasses.fields(Design) if f.name != "per_track"}
  design = Design(**asked)
  if config.quick:
    design = dataclasses.replace(design, streams=4, tracks=2, per_track=2)
  drivers = drivers_of(config.policy, config.controllers, config.names, config.speed)
  config.out.mkdir(parents=True, exist_ok=True)
  who = identities(config.policy, config.controllers)
  about = json.loads(json.dumps([dataclasses.asdict(design), list(drivers), who]))
  kept = Kept(config.out / "driven.json", about)
  driven = compare(drivers, design, lambda text: print(text, flush=True), kept)
  first = next(iter(drivers))
  write_json(config.out / "comparison.json", as_json(driven, first, design, config.policy))
  table = in_markdown(driven, first)
  write_text(config.out / "comparison.md", table)
  print(table)


if __name__ == "__main__":
  run_script()
