"""The path-tracking task wired up: plant, sensors and filter, speed control and demonstrator by name.

Importing this module registers `QcarTwin/PathTracking-v0` with gymnasium; every field of `Options` is an argument.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from agents.control import controllers
from agents.control.interface import Situation
from agents.control.model import Model
from agents.control.speed import SpeedController, SpeedGains
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.fleet import Demonstrator, Fleet, FleetConfig, Spread
from qcar_twin.envs.gym_env import PathTrackingEnv
from qcar_twin.envs.task import Reward, TrackingTask
from qcar_twin.extras import extra
from qcar_twin.paths import Errors, path_named
from qcar_twin.plant import Plant
from qcar_twin.sensors.suite import qcar_sensors
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.twin import Twin

with extra("The gymnasium environment"):
  import gymnasium

Array = NDArray[np.float64]
ENV_ID = "QcarTwin/PathTracking-v0"
SERVO = (0.02, 0.04)  # s, delay and lag of the servo for a plant that has none


@dataclasses.dataclass(frozen=True)
class Options:
  """What an environment is made of.

  Attributes:
    path: s, o, infinity or c.  speed: m/s.  laps: of a closed path.
    plant: "twin", "reduced" or "bicycle"; `own_plant` of `fleet` takes any other.
    twin: twin file of a calibrated or repaired twin; the nominal twin without it.
    substeps: simulation steps of the twin per control period; 2 is meant for training, 5 for everything else.
    estimator: what the agent sees: the federated filter on noisy sensors, or the truth.
    demonstrator, version: controller of agents/data/controllers.toml whose steering angle the reward compares with;
      "" for none.
    steering_gain, steering_offset: of the linkage, - and deg; neither agent nor filter knows them.
    gain_spread, offset_spread: half-widths around them, - and deg, within which every episode's linkage is drawn.
    randomise: draw the twin's measured parameters within their standard deviations for every episode.
    start_offset, start_heading: episodes start within +- these, m and rad.
    reward: weights.
  """

  path: str = "s"
  speed: float = 0.5
  laps: int = 1
  plant: Literal["twin", "reduced", "bicycle"] = "twin"
  twin: str = ""
  substeps: int = 2
  estimator: Literal["fekf", "truth"] = "fekf"
  demonstrator: str = "lq_ed"
  version: str = "loose"
  steering_gain: float = 1.0
  steering_offset: float = 0.0
  gain_spread: float = 0.0
  offset_spread: float = 0.0
  randomise: bool = False
  start_offset: float = 0.05
  start_heading: float = 0.1
  reward: Reward = Reward()


OwnPlant = tuple[Callable[[], Plant], Array]
"""Makes a plant, and its parameters (P,)."""


def task_of(options: Options, lock: float = 0.5236) -> TrackingTask:
  """The task; a lock of the steering in rad."""
  delay, lag = SERVO if options.plant == "bicycle" else (0.0, 0.0)
  return TrackingTask(
    path_named(options.path),
    options.speed,
    options.laps,
    options.reward,
    lock=lock,
    start_offset=options.start_offset,
    start_heading=options.start_heading,
    steering_gain=options.steering_gain,
    steering_offset=float(np.radians(options.steering_offset)),
    gain_spread=options.gain_spread,
    offset_spread=float(np.radians(options.offset_spread)),
    servo_delay=delay,
    servo_lag=lag,
  )


def plant_of(options: Options, model: Model) -> OwnPlant:
  """The plant that the options name."""
  if options.plant == "bicycle":
    return partial(Bicycle, model.vehicle), model.theta
  engine = "reduced" if options.plant == "reduced" else "mujoco"
  if options.twin:
    theta = load_twin(options.twin, substeps=options.substeps, threads=1)[1]
    return lambda: load_twin(options.twin, substeps=options.substeps, threads=1)[0].on(engine), theta
  make = partial(Twin, model.vehicle, substeps=options.substeps, threads=1, engine=engine)
  return make, make().parameters.nominal


def demonstrator_of(options: Options, model: Model) -> Demonstrator | None:
  """The controller whose steering angle the reward compares with.

  Raises:
    KeyError: no such controller or version.
  """
  if not options.demonstrator:
    return None
  table = controllers.entries()
  if options.version not in table.get(options.demonstrator, {}):
    known = ", ".join(f"{name} {version}" for name, versions in table.items() for version in versions)
    raise KeyError(f"no controller '{options.demonstrator} {options.version}' to learn from; there are {known}")
  numbers = table[options.demonstrator][options.version]
  lock = model.vehicle.max_steering
  controller = controllers.make(options.demonstrator, numbers, model.car, options.speed, lock)
  path = path_named(options.path)

  def steer(errors: Errors, speed: Array) -> Array:
    return controller.steer(Situation(path, np.zeros_like(speed), errors, speed, np.zeros_like(speed), 0.01))

  return steer


def prior_spread(plant: Plant) -> Spread:
  """The parameters a person measures, within their stated standard deviations, independent of each other."""
  known = [p for p in plant.parameters if p.std]
  return Spread(tuple(p.name for p in known), np.diag([float(p.std or 0.0) ** 2 for p in known]))


def fleet(
  options: Options,
  seeds: Sequence[int],
  model: Model | None = None,
  own_plant: OwnPlant | None = None,
  spread: Spread | None = None,
) -> Fleet:
  """N cars, one per seed.

  Args:
    model: the identified model of filter, speed control and demonstrator; the nominal one without it.
    own_plant: instead of the one the options name; it must have a servo of its own.
    spread: of the plant's parameters over episodes, for instance a calibration's covariance.
  """
  model = model or Model.nominal()
  make, theta = own_plant or plant_of(options, model)
  if options.randomise and spread is None:
    spread = prior_spread(make())
  sensed = options.estimator == "fekf"
  config = FleetConfig(
    plant=make,
    theta=theta,
    speed_control=partial(SpeedController, SpeedGains.design(model.car)),
    demonstrator=demonstrator_of(options, model),
    sensors=qcar_sensors() if sensed else None,
    car=model.car,
    settings=model.filter_settings(options.plant) if sensed else None,
    spread=spread,
  )
  return Fleet(task_of(options, model.vehicle.max_steering), config, seeds)


def make_env(render_mode: str | None = None, seed: int = 0, **options: Any) -> PathTrackingEnv:
  """One car as a gymnasium environment; keyword arguments are the fields of `Options`."""
  return PathTrackingEnv(fleet(Options(**options), [seed]), render_mode)


if ENV_ID not in gymnasium.registry:
  gymnasium.register(ENV_ID, entry_point="agents.learning.environments:make_env")
