"""What a training by reward alone is asked for: hyperparameters, environment, what is seen, seed."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agents.learning.critic import CRITICS
from agents.learning.environments import Options, one_of_them, options_from, saved_options
from agents.learning.hyperparameters import Hyperparameters, read_hyperparameters
from agents.learning.observation import OBSERVATIONS
from qcar_twin.envs.task import Reward
from qcar_twin.tracks import path_from
from qcar_twin.untrusted import UnreadableFile, read_json

LOOKS = 12  # evaluations, and checkpoints, of a training
CLOSEST = 5000  # environment steps between them: DDPG's, with one car's step an update, take as long as an evaluation
TRACKS = Options(
  path="random:1:400",
  speed=0.9,
  speed_spread=0.6,
  stretch=6.0,
  plant="reduced",
  demonstrator="",
  gain_spread=0.1,
  offset_spread=1.5,
  reward=Reward(m3=0.0, m4=0.0, m5=0.01, m6=0.0, near=0.001),
)
"""The default task: 400 m of random track on the reduced car, 6 m an episode, each with its own linkage and speed."""
DRAWN = ("randomise", "diagnosis", "informed")
SEEING = ("ppo",)  # algorithms whose critic may see more than their actor
TAKEN = ("plant", "twin", "estimator", "unknown", "steering_gain", "steering_offset", *DRAWN)
PAPERS = ("episodes", "demonstrator", "version", "demonstrator_weight", "demonstrations", "near", "cars", "wide")


@dataclasses.dataclass(frozen=True)
class Trial:
  """One training by reward.

  Attributes:
    hyperparameters: of the algorithm.  options: of the environment.
    observation: what is seen, a key of `OBSERVATIONS`.  seed: of everything random.
    every: environment steps between evaluations, each with a checkpoint; 0 for none of either: what it ends with is
      kept.
    seconds: of the processor after which it ends; 0 for none.
    critic: what the critic sees, one of `CRITICS`.

  Raises:
    ValueError: a choice there isn't, or a critic that the algorithm has no place for.
  """

  hyperparameters: Hyperparameters
  options: Options = TRACKS
  observation: str = "wide"
  seed: int = 0
  every: int = 500_000
  seconds: float = 0.0
  critic: str = "own"

  def __post_init__(self) -> None:
    one_of_them("observation", self.observation, tuple(OBSERVATIONS))
    one_of_them("critic", self.critic, CRITICS)
    if self.critic == "truth" and self.hyperparameters.algorithm not in SEEING:
      raise ValueError(f"a critic that sees the truth is for {', '.join(SEEING)}; take --critic own")

  def as_json(self) -> dict[str, Any]:
    return dataclasses.asdict(self)

  @classmethod
  def kept(cls, file: Path) -> "Trial":
    """The trial in a training's folder. Raises UnreadableFile where it is none."""
    table = read_json(file)
    try:
      hyper = Hyperparameters(**table["hyperparameters"])
      return cls(**{**table, "hyperparameters": hyper, "options": saved_options(table["options"])})
    except (KeyError, TypeError, ValueError) as error:
      raise UnreadableFile(f"{file}: is no plan of a training by reward ({error}); choose another folder") from error


def is_by_reward(folder: Path) -> bool:
  """Whether a folder holds a training by reward, finished or not."""
  file = folder / "training.json"
  return file.is_file() and "hyperparameters" in read_json(file)


def trial_from(asked: Mapping[str, Any], defaults: Mapping[str, Any]) -> Trial:
  """The training that options of `qcar-twin train`, by name, ask for; what is at its default is the file's to say.
  One that is resumed is the folder's own.

  Raises:
    ValueError: an option is given that belongs to the paper's training.
  """
  if asked["resume"] and (kept := asked["out"] / "training.json").is_file():
    return Trial.kept(kept)
  changed = {name: asked[name] for name in (*TAKEN, *PAPERS) if asked[name] != defaults[name]}
  if foreign := [name for name in PAPERS if name in changed]:
    option = "--" + foreign[0].replace("_", "-")
    raise ValueError(f"{option} is of the paper's training; leave it out, or leave out --algorithm")
  hyper = read_hyperparameters(asked["algorithm"], asked["hyperparameters"])
  options = dataclasses.replace(options_from(hyper.env_kwargs) if hyper.env_kwargs else TRACKS, **changed)
  if path := asked["path"]:
    stretch = options.stretch if path.startswith("random:") else 0.0
    options = dataclasses.replace(options, path=path, stretch=min(stretch, path_from(path).length))
  if asked["quick"]:
    hyper, options = quickly(hyper), dataclasses.replace(options, estimator="truth")
  seen = asked["observation"] if asked["observation"] != "auto" else hyper.observation
  critic = asked["critic"] if asked["critic"] != "auto" else "truth" if hyper.algorithm in SEEING else "own"
  return Trial(hyper, options, seen, asked["seed"], max(CLOSEST, hyper.steps // LOOKS), critic=critic)


def in_words(result: Mapping[str, Any]) -> str:
  """What came of it, in a line."""
  seconds, best = result["seconds"]["cpu"], 1e3 * result["best_rmse_kept_aside"]
  return f"{result['updates']} updates in {seconds:.0f} s of CPU, best {best:.1f} mm RMSE on tracks kept aside"


def quickly(hyper: Hyperparameters) -> Hyperparameters:
  """A few thousand steps, to test that everything runs."""
  cars = min(hyper.cars, 16)
  if "learning_starts" in hyper.rest:
    steps, small = 40 * cars, {"learning_starts": 64, "buffer_size": 10_000}
  else:
    steps, small = 2 * 64 * cars, {"n_steps": 64, "batch_size": 64 * cars}
  return dataclasses.replace(hyper, steps=steps, cars=cars, rest=hyper.rest | small)
