"""A car whose answers are exactly linear in its parameters, so that every stage has a closed form to be held against.

Signals are fixed linear filters of the commands times parameters. Real mechanisms lend their names and
declarations; what they do to this car is the columns below.
"""

from types import SimpleNamespace

import numpy as np

from calibration.diagnosis.candidates import Candidate, candidate, refine, simulate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.scan import scan
from calibration.fitting.likelihood import Problem, Weighting
from calibration.fitting.noise import ChannelNoise
from calibration.fitting.observations import CHANNELS, observe
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.fitting.windows import cut_recordings
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.plant import COMMANDS, SIGNALS, Prediction
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.mechanisms import select
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.similarity import Similarity

PERIOD, LENGTH, SAMPLING = 0.01, 6.0, 0.05  # s
NOISE = {"motor_speed": 8.0, "accel_x": 0.5, "accel_y": 0.5, "yaw_rate": 0.15}
VEHICLE = SimpleNamespace(
  gear_ratio=0.1, wheel_radius=0.03, max_steering=0.5, cg_to_front=0.13, cg_to_rear=0.12, cg_height=0.04,
  commands=COMMANDS, command_scale=1.0, drive="voltage", motor=DRIVES["voltage"], supply_voltage=12.0,
  similarity=Similarity.of(0.25),
)  # fmt: skip
BASE = ParameterSet(
  (
    Parameter("torque_per_volt", 100.0, 10.0, 400.0, "N m/V", typical=30.0),
    Parameter("motor_damping", 20.0, 0.0, 200.0, "N m s/rad", typical=6.0),
    Parameter("cornering_stiffness_front", 4.0, 0.5, 20.0, "N/rad", typical=1.0),
    Parameter("mass", 2.7, 2.0, 3.5, "kg", std=0.02),
  )
)
MECHANISMS = ("steering_offset", "quadratic_drag", "gyro_scale", "side_force")


class LinearTwin:
  """Answers like a Twin; `rollout` is linear in theta to the last bit but for rounding."""

  period, engine = PERIOD, "linear"

  def __init__(self, mechanisms=MECHANISMS):
    self.vehicle, self.base, self.mechanisms = VEHICLE, BASE, select(mechanisms)
    self.parameters = BASE + [p for m in self.mechanisms for p in m.parameters]
    self._known: list = []  # segments and their columns, (P, S, T + 1, 10)

  def rollout(self, theta, segments):
    columns = next((c for s, c in self._known if s is segments), None)
    if columns is None:
      columns = np.stack([response(name, segments) for name in self.parameters.names])
      self._known.append((segments, columns))
    signals = np.tensordot(np.atleast_2d(theta), columns, axes=1)
    if segments.pose is not None:  # this car always is where it was seen
      signals[..., :3] = np.nan_to_num(segments.pose)
    return Prediction(signals, segments.period)


def response(name, segments):
  """Change of all signals per unit of a parameter, (S, T + 1, 10)."""
  volts, steering = segments.commands[..., 0], segments.commands[..., 1]
  ones = np.ones_like(volts)
  effects = {
    "torque_per_volt": {"motor_speed": lag(volts, 0.3), "accel_x": 0.01 * (volts - lag(volts, 0.3))},
    "motor_damping": {"motor_speed": -lag(lag(volts, 0.3), 0.3)},
    "cornering_stiffness_front": {"yaw_rate": lag(steering, 0.1)},
    "mass": {"accel_y": lag(steering * volts, 0.1)},
    "steering_offset": {"yaw_rate": 4.0 * lag(ones, 0.1), "accel_y": 3.0 * lag(volts, 0.1)},
    "quadratic_drag": {"motor_speed": -12.0 * lag(volts * np.abs(volts), 0.6)},
    "gyro_scale": {"yaw_rate": 4.0 * lag(steering, 0.1)},
    "side_force": {"accel_y": 0.4 * lag(ones, 0.05)},
    "gyro_bias": {"yaw_rate": ones},
    "side_force_x": {"accel_y": lag(steering, 0.2)},
  }[name]
  out = np.zeros((*volts.shape[:1], volts.shape[1] + 1, len(SIGNALS)))
  for signal, value in effects.items():
    out[:, 1:, SIGNALS.index(signal)] = value
  out[..., SIGNALS.index("velocity_x")] = 0.003 * out[..., SIGNALS.index("motor_speed")]
  return out


def lag(value, constant):
  """First-order low pass over the last axis, starting at rest."""
  share, out, state = PERIOD / constant, np.empty_like(value), np.zeros_like(value[:, 0])
  for k in range(value.shape[1]):
    state = state + share * (value[:, k] - state)
    out[:, k] = state
  return out


def drive(count=10, seed=0, pose=False):
  """Recordings with commands and empty measurements; the last fifth has the role validate."""
  random = np.random.default_rng(seed)
  recordings = []
  time = np.arange(0.0, LENGTH - 1e-9, PERIOD)
  sampled = np.arange(0.0, LENGTH + 1e-9, SAMPLING)
  for k in range(count):
    volts = 1.5 + np.repeat(random.uniform(-1.2, 1.5, 12), len(time) // 12)
    steering = 0.25 * np.sin(2 * np.pi * random.uniform(0.2, 0.8) * time + random.uniform(0, 6)) + random.uniform(
      -0.1, 0.1
    )
    streams = {"motor_voltage": Stream(time, volts), "steering_command": Stream(time, steering)}
    streams |= {name: Stream(sampled, 0.0 * sampled) for name in NOISE}
    if pose:
      streams |= {"pose_x": Stream(sampled, np.cos(sampled + k)), "pose_y": Stream(sampled, np.sin(sampled + k)),
                  "pose_yaw": Stream(sampled, 0.1 * sampled)}  # fmt: skip
    recordings.append(Recording(f"run_{k}", streams, role="validate" if k >= 0.8 * count else "identify"))
  return recordings


def measure(twin, recordings, truth, seed=1, noise=1.0):
  """The same recordings with what a car with parameters `truth` shows, plus white noise."""
  random = np.random.default_rng(seed)
  segments = cut_recordings(recordings, VEHICLE).segments
  signals = twin.rollout(twin.parameters.vector(truth)[None], segments).signals[0]
  grid = PERIOD * np.arange(signals.shape[1])
  out = []
  for k, recording in enumerate(recordings):
    streams = dict(recording.streams)
    for name, std in NOISE.items():
      time = recording[name].time
      value = np.interp(time, grid, signals[k, :, SIGNALS.index(name)])
      streams[name] = Stream(time, value + noise * std * random.standard_normal(len(time)))
    out.append(recording.replace(streams=streams))
  return out


def problem_of(twin, recordings):
  """Whitened by the true noise; samples independent."""
  observations = observe(recordings, VEHICLE)
  std = np.array([NOISE.get(name, 0.02) for name in CHANNELS])
  judging = [k for k, r in enumerate(recordings) if r.role == "validate"]
  fitted = int(np.sum(~np.isin(observations.recording, judging)))
  weighting = Weighting(std, np.ones(len(CHANNELS)), np.ones(len(observations)))
  return Problem(twin, observations, weighting, fitted)


def solved(problem, mechanisms=()) -> Candidate:
  """The maximum a posteriori model: exact after two Gauss-Newton steps, since the car is linear."""
  model = candidate(problem, mechanisms, None, BASE)
  simulate(problem, [model])
  refine(problem, [model], 1, full=True)
  model.settled = False
  refine(problem, [model], 2, full=True)
  return model


def baseline_of(problem, base) -> RecalibratedTwin:
  noise = {n: ChannelNoise(s, 0.0, "standstill", 0.0, 0.0, 50.0, 0.02) for n, s in NOISE.items()}
  return RecalibratedTwin(problem, noise, None, base.theta, base.jacobian, 0)  # type: ignore[arg-type]


def pool_of(problem, mechanisms=MECHANISMS) -> Pool:
  """The recalibrated car and every single mechanism, all fitted."""
  base = solved(problem)
  signatures = scan(problem, base, problem.twin.mechanisms)
  models = {frozenset(): base} | {frozenset([name]): solved(problem, (name,)) for name in mechanisms}
  return Pool(problem=problem, priors=BASE, models=models, signatures=signatures, floor=dict(NOISE))


def session(truth=None, seed=0, noise=1.0, pose=False):
  """A pool for a car with the given parameters, ready to be located, decided and shown."""
  twin = LinearTwin()
  recordings = measure(twin, drive(seed=seed, pose=pose), truth or {}, seed + 1, noise)
  return pool_of(problem_of(twin, recordings))
