"""The full-size car by CommonRoad's multi-body model (29 states), where commonroad-vehicle-models is installed.

Nothing of the product imports it, nor does a test: pip install commonroad-vehicle-models.
"""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.sizes.cars import STEP, Array, SizedCar, commands, logged

_VX, _VY, _YAW_RATE, _STEERING = 3, 10, 5, 2
_SLOWEST = 5.0  # m/s: below it the model's wheels are stiffer than the steps stand
_PARTS = 4  # steps of fourth order within one of the log's


def drive_multi_body(car: SizedCar, seconds: float, seed: int) -> dict[str, Array]:
  """Columns of one log, as of `cars.drive`; cruise control and servo as there, everything else CommonRoad's."""
  dynamics = import_module("vehiclemodels.vehicle_dynamics_mb").vehicle_dynamics_mb
  numbers = _plain(import_module("vehiclemodels.parameters_vehicle2").parameters_vehicle2())
  time, wanted, steering = commands(car, seconds, seed)
  wanted = np.maximum(wanted, _SLOWEST)
  core = [0.0, 0.0, 0.0, _SLOWEST, 0.0, 0.0, 0.0]
  state = np.array(import_module("vehiclemodels.init_mb").init_mb(core, numbers), dtype=float)

  def rates(x: Array, k: int) -> Array:
    turn = float(np.clip((steering[k] - x[_STEERING]) / car.servo, -car.servo_rate, car.servo_rate))
    return np.array(dynamics(x.tolist(), [turn, car.force(wanted[k], float(x[_VX])) / car.mass], numbers))

  kept, h = np.empty((time.size, 4)), STEP / _PARTS
  for k in range(time.size):
    kept[k] = state[[_VX, _VY, _YAW_RATE, _STEERING]]
    for _ in range(_PARTS):
      a = rates(state, k)
      b = rates(state + 0.5 * h * a, k)
      c = rates(state + 0.5 * h * b, k)
      state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(state + h * c, k))
  felt = np.gradient(kept[:, :2], STEP, axis=0) + kept[:, 2:3] * np.stack([-kept[:, 1], kept[:, 0]], axis=1)
  return logged(car, time, wanted, steering, kept, felt, seed)


def _plain(config: Any) -> Any:
  """The same numbers without OmegaConf's attribute access, which costs most of the time."""
  if not hasattr(config, "items"):
    return config
  return SimpleNamespace(**{key: _plain(value) for key, value in config.items()})
