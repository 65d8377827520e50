"""Film a policy, a controller or a recording, with a translucent second car where asked for.

qcar-twin render --out film.mp4 [--policy DIR] [--path c] [--ghost "lq_ed tuned"] [--camera chase]

qcar-twin render --out film.mp4 --dataset DIR --recording NAME [--twin twin.toml]
"""

import dataclasses
from pathlib import Path
from typing import Literal

from agents.learning.evaluate import EvaluationCase, contestants, run_case
from agents.learning.policy_file import SHIPPED
from agents.learning.sb3_zip import any_policy
from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.rendering.film import Array, Film, Look, require_film, signals_of, write_still, write_video
from qcar_twin.tracks import path_from
from qcar_twin.twin.file import command_shift_of, load_twin
from qcar_twin.vehicle.vehicle import Vehicle

OUT_IS_FILE = True
POSITIVE = ("fps", "size")


@dataclasses.dataclass(frozen=True)
class Config:
  """The drive that is filmed, and the camera."""

  out: Path
  """File (mp4) to write; a still of its middle is written next to it as PNG."""
  policy: Path = SHIPPED
  """Folder of the policy, or a zip of stable-baselines3."""
  driver: str = "policy"
  """Driver of the solid car: policy, or a controller such as "lq_cm tuned"."""
  ghost: str = ""
  """Driver of the translucent car; none where empty."""
  path: str = "c"
  """Path to follow: s, o, infinity, c, random:SEED, or a CSV file of points x, y in m."""
  plant: Literal["mujoco", "reduced", "bicycle"] = "mujoco"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, or the bicycle."""
  dataset: Path | None = None
  """Show a recording of this data set instead of a drive."""
  recording: str = ""
  """Name of the recording."""
  twin: str = ""
  """Twin file (TOML) whose prediction is the translucent car of a recording."""
  camera: Literal["chase", "top", "onboard"] = "chase"
  """Camera on the solid car."""
  fps: int = 25
  """Frame rate, Hz."""
  size: tuple[int, int] = (640, 480)
  """Width and height of the film, pixels."""
  quick: bool = False
  """Film two seconds in half the size."""


def driven(config: Config, driver: str) -> Array:
  """Signals (T, 10) of a drive."""
  case = EvaluationCase(config.path, config.plant, cars=1)
  known = contestants({"policy": config.policy} if driver == "policy" else {}, case.speed, driver != "policy")
  if driver not in known:
    raise ValueError(f"nobody is called '{driver}'; there are policy, {', '.join(known)}")
  drive = run_case(known[driver], case)
  return drive.signals[drive.under_way[:, 0], 0]


def recorded(config: Config, dataset: Path) -> tuple[Array, Array | None, Vehicle]:
  """Signals of a recording, and of the twin under the same commands from the same start; and the car."""
  data = DataSet.load(dataset)
  recording, vehicle = data[config.recording], Vehicle.from_dataset(data.vehicle, data.vehicle_std)
  signals, ghost = signals_of(recording.resample(0.01)), None
  if config.twin:
    twin, theta = load_twin(config.twin, threads=1)
    cut = Cut(length=recording.duration + 1.0, command_shift=command_shift_of(config.twin))
    ghost = twin.rollout(theta[None], cut_recordings([recording], twin.vehicle, cut).segments).signals[0, 0]
  return signals, ghost, vehicle


def main(config: Config) -> None:
  """Render."""
  require_film(config.out)
  path, vehicle = None, Vehicle.load()
  if config.dataset:
    signals, ghost, vehicle = recorded(config, config.dataset)
  else:
    path, signals = path_from(config.path), driven(config, config.driver)
    ghost = driven(config, config.ghost) if config.ghost else None
  width, height = (x // 2 if config.quick else x for x in config.size)
  film = Film(path, vehicle, look=Look(config.camera, width, height, config.fps), ghost=ghost is not None)
  driver = any_policy(config.policy).name if config.driver == "policy" and not config.dataset else config.driver
  label = config.recording or (f"{driver}; ghost: {config.ghost}" if config.ghost else driver)
  shown = signals[: 200 if config.quick else None]
  count = write_video(config.out, film.frames(shown, ghost, label=label), config.fps)
  middle = len(signals) // 2
  still = film.frame(signals[middle], None if ghost is None else ghost[min(middle, len(ghost) - 1)], label)
  write_still(config.out.with_suffix(".png"), still)
  film.close()
  print(f"{config.out}: {count} frames")


if __name__ == "__main__":
  run_script()
