"""How far an independent car drives from itself: floor and draught that a log does not hold, and no model predicts."""

import numpy as np

from calibration.concealed.benchmarks.known import CARS
from calibration.concealed.benchmarks.under_way import recalibrated_error
from calibration.concealed.laboratory.manoeuvres import PERIOD
from calibration.concealed.laboratory.written import Session
from calibration.concealed.proving_ground.plant import ProvingGroundPlant
from calibration.concealed.proving_ground.session import Spec
from calibration.concealed.proving_ground.session import drawn_car as first_car
from calibration.concealed.second_car.plant import SecondCarPlant
from calibration.concealed.second_car.session import drawn_car as second_car
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.noise_floor import driving_noise, residual_floor
from qcar_twin import markdown

_START = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "road")
_SIGNAL = {"motor_speed": "motor", "accel_x": "accel_x", "accel_y": "accel_y", "yaw_rate": "yaw_rate"}
_PLANTS = {
  "first": lambda seed, noise: ProvingGroundPlant(first_car(Spec(seed)), noise=noise, seed=seed),
  "second": lambda seed, noise: SecondCarPlant(second_car(seed), noise=noise, seed=seed),
}


def disturbed(car: str, seed: int, session: Session, noise: float = 1.0) -> dict[str, np.ndarray]:
  """True signals of a car with floor and draught minus those of the same car without, under a session's commands.

  Each recording from its own start, as long as a stretch that a fit simulates. Equations, numbers and integration are
  the car's own, so this is what the best of models would err by, before the sensors add their noise.

  Args:
    car: "first" or "second".
    seed, session: of that car; the session's signals give the starts.
    noise: factor on the disturbances.
  """
  signals = list(session.truth["signals"])
  own, start = [name for name in signals if name != "motor_angle"], [signals.index(name) for name in _START]
  starts = np.array([session.clean[recording.name][0, start] for recording in session.recordings])
  whole = [np.stack([r[n].value for n in ("motor_voltage", "steering_command")], axis=1) for r in session.recordings]
  commands = [given[: round(LONGEST / PERIOD)] for given in whole]
  held = np.stack([np.pad(c, ((0, max(map(len, commands)) - len(c)), (0, 0)), mode="edge") for c in commands], axis=1)
  drives = []
  for factor in (noise, 0.0):
    drive = _PLANTS[car](seed, factor).begin(starts)
    drives.append(np.array([drive.step(command) for command in held]))
  error = [(drives[0] - drives[1])[: len(c), k] for k, c in enumerate(commands)]
  return {channel: np.concatenate(error)[:, own.index(name)] for channel, name in _SIGNAL.items()}


def disturbance_table(seed: int, sessions: int) -> str:
  """Errors of recalibrated twins and of the cars themselves, in multiples of the sensors' noise, as Markdown."""
  rows = []
  for car in _PLANTS:
    for k in range(seed, seed + sessions):
      session = CARS[car](k)
      noise = residual_floor(driving_noise(session.recordings))
      own, twin = disturbed(car, k, session), recalibrated_error(session)
      least = {name: float(np.hypot(1.0, np.sqrt(np.mean(e**2)) / noise[name])) for name, e in own.items()}
      rows.append((f"{car}, {k}", *(f"{twin[name]:.2f}; {least[name]:.2f}" for name in _SIGNAL)))
  titles = ("car, seed", *(name.replace("_", " ") for name in _SIGNAL))
  return "\n".join(markdown.table(titles, rows)) + "\n"
