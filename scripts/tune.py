"""Tune the path-tracking controllers on one path, and keep them with their origin.

qcar-twin tune --out agents/data/controllers.toml [--plant reduced --path random:2:30 --linkages 16]
"""

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
from joblib import delayed

from agents.control.controllers import FAMILIES, entries, save
from agents.control.model import Model
from agents.control.tuning import Search, origin_of, spread_linkages, tune
from calibration.identification.identification import Identification
from calibration.progress import StageLine, staged
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel

LOOSE = {
  "ff_fb": {"gain": 1.0, "preview": 0.3},
  "lq_ed": {"cross_track_rate": 0.001, "heading": 0.05, "heading_rate": 0.001, "effort": 0.05},
  "lq_cm": {"cross_track_rate": 0.001, "heading": 0.05, "heading_rate": 0.001, "effort": 0.05},
  "linear_rate": {"cross_track": 60.0, "cross_track_rate": 20.0, "heading": 10.0, "heading_rate": 2.0},
}
LOOSE_ORIGIN = (
  "chosen by hand without tuning, as a first guess of the kind one would try on the car; kept for comparison"
)
KEPT = "controllers that were tuned are in the file"

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Search every controller's numbers for the least RMSE on a path."""

  out: Path
  """TOML file that is updated."""
  identified: Path | None = None
  """Identification file (JSON) of the car; the nominal QCar where not given."""
  controllers: tuple[str, ...] = tuple(FAMILIES)
  """Controllers to tune."""
  speed: float = 0.5
  """Reference speed, m/s."""
  plant: Literal["mujoco", "reduced", "bicycle"] = "bicycle"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, or the bicycle with a servo."""
  path: str = "s"
  """Path that is driven: s, o, infinity, c, random:SEED[:LENGTH] or FILE.csv."""
  linkages: int = 0
  """Cars of a trial with linkages drawn as for an agent that learns by reward (gain 1 +- 0.1, offset +- 1.5 deg);
  0 for the four of gain 0.95 to 1.05 and offset +- 0.5 deg."""
  unknown: tuple[str, ...] = ()
  """Parameters that the filter estimates as extra states, as `track` does; none: the plain filter."""
  seed: int = 0
  """Seed of sensors and search."""
  workers: int = 1
  """Number of controllers that are tuned in parallel, one core each."""
  ray: bool = False
  """Run on the Ray cluster at hand instead of in local processes; needs the extra 'cluster'."""
  quick: bool = False
  """Two small generations instead of eight."""


def model_of(config: Config) -> Model:
  """The model the gains are computed from."""
  nominal = Model.nominal()
  if config.identified is None:
    return nominal
  return dataclasses.replace(nominal, theta=Identification.load(config.identified).theta)


def main(config: Config) -> None:
  """Tune, and write the file after each controller."""
  model, search = model_of(config), Search(speed=config.speed, seed=config.seed)
  if config.quick:
    search = dataclasses.replace(search, candidates=4, elite=2, generations=2)
  plant, theta = model.plant(config.plant)
  search = dataclasses.replace(search, path=config.path)
  if config.linkages:
    search = dataclasses.replace(search, mismatch=spread_linkages(0.1, 1.5, config.linkages, config.seed))
  if config.plant != "bicycle":
    search = dataclasses.replace(search, servo=(0.0, 0.0))
  table = entries(config.out)
  families = [FAMILIES[name] for name in config.controllers]
  filtered = model.filter_settings(config.plant).estimating(*config.unknown)
  stages = [f"tuning {family.name}" for family in families]
  with StageLine(dict.fromkeys(stages, 1.0), "agents") as progress:  # each drives as many candidates
    # other processes can't be heard
    heard = None if config.workers > 1 or config.ray else lambda name, share: progress(f"tuning {name}", share)
    calls = [delayed(tune)(family, plant, theta, model.car, filtered, search, heard) for family in families]
    for index, tuned in staged(in_parallel(calls, config.workers, config.ray), stages, progress):
      name = families[index].name
      origin = origin_of(search, config.plant, plant.parameters.named(theta), config.unknown)
      entry = tuned.numbers | {"rmse": tuned.rmse, "steering_rate": tuned.steering_rate, "origin": origin}
      table[name] = {"loose": LOOSE[name] | {"origin": LOOSE_ORIGIN}, "tuned": entry}
      save(table, config.out)
      rate = np.degrees(tuned.steering_rate)
      progress.say(f"{name}: RMSE {1e3 * tuned.rmse:.2f} mm at {rate:.0f} deg/s rms -> {config.out}")


if __name__ == "__main__":
  run_script()
