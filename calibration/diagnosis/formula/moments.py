"""Every variable of a formula over the driving, as the twin's mechanisms will see it."""

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.pulses import WIDTH
from calibration.fitting.observations import Observations
from calibration.fitting.windows import Stretches
from qcar_twin.plant import SIGNALS, Prediction
from qcar_twin.twin.formula.mechanism import leaky, moving
from qcar_twin.twin.formula.variables import VARIABLES
from qcar_twin.twin.mechanisms.base import Context
from qcar_twin.twin.parameters import quantities
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


def moments(twin: Twin, theta: Array, observations: Observations, prediction: Prediction) -> Context:
  """All control periods of all stretches as one context, stretch by stretch, S * T rows.

  Args:
    twin: with the parameters (P,).
    observations: what was driven.
    prediction: the twin's signals, one vector.
  """
  segments = observations.stretches.segments
  count, length = segments.commands.shape[:2]
  signals = prediction.signals[0][:, :length].reshape(-1, len(SIGNALS))
  known = segments.measured_pose[:, :length].reshape(-1, 4)
  simulated = np.column_stack([signals[:, :3], np.zeros(len(signals))])
  known = np.where(np.isfinite(known), known, simulated)
  values = quantities(theta[None], twin.base, twin.vehicle)
  constant = lambda name: np.full(count * length, float(values[name][0]))
  time = np.tile(segments.period * np.arange(length), count)
  return Context(
    car=twin.car,
    period=segments.period,
    time=time,  # type: ignore[arg-type]
    signals=signals,
    commands=segments.commands.reshape(-1, 2) * [twin.vehicle.command_scale, 1.0],
    history=np.zeros((count * length, 2)),
    recording_time=np.repeat(segments.offset, length) + time,
    pose=known[:, :3],
    wheel_angle=known[:, 3],
    torque_per_volt=constant("torque_per_volt"),
    motor_damping=constant("motor_damping"),
  )


def variables(context: Context, observations: Observations) -> dict[str, Array]:
  """Every variable of VARIABLES at every control period, (S, T); without a measured pose none that needs one."""
  shape = observations.stretches.segments.commands.shape[:2]
  posed = any(name.startswith("pose_") for name in observations.present)
  out = {}
  for name, variable in VARIABLES.items():
    if variable.needs == "pose" and not posed:
      continue
    value = np.asarray(variable.value(context), dtype=np.float64).reshape(shape)
    out[name] = leaky(value, variable.memory / context.period) if variable.memory else value
  return out


def fading(context: Context, stretches: Stretches) -> Array:
  """How much of a force that vanishes at rest there is, (S, T)."""
  return moving(context).reshape(stretches.segments.commands.shape[:2])


def by_pulse(values: Array, period: float) -> Array:
  """Means over pulses (S, K, ...) of values at control periods (S, T, ...)."""
  per = int(round(WIDTH / period))
  count = -(-values.shape[1] // per)
  padded = np.zeros((values.shape[0], count * per, *values.shape[2:]))
  padded[:, : values.shape[1]] = values
  return padded.reshape(values.shape[0], count, per, *values.shape[2:]).mean(axis=2)
