"""Stiffness and friction of a tyre fall with load each by itself: a fit tells the two exponents apart."""

import numpy as np
import pytest

from calibration.fitting.optimiser import fit
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

TIME = 0.01 * np.arange(300)
NOISE = {"accel_x": 0.25, "accel_y": 0.25, "yaw_rate": 0.01, "motor_speed": 2.0}
OPEN = ("cornering_stiffness_front", "cornering_stiffness_rear", "friction_coefficient", "longitudinal_stiffness")


def turns() -> Segments:
  """From a gentle one to a slide, and throttle in one: loads shift across and along."""
  angles, drives = np.array([0.05, 0.12, 0.2, 0.3, 0.12, 0.2]), np.array([1.6, 1.6, 2.2, 2.6, 1.2, 2.0])
  wave = 0.6 * np.sign(np.sin(2 * np.pi * 0.5 * TIME)) * (np.arange(6) > 3)[:, None]
  steer = angles[:, None] * np.sin(2 * np.pi * np.array([0.3, 0.5, 0.4, 0.3, 0.2, 0.4])[:, None] * TIME)
  commands = np.stack([drives[:, None] + wave, steer], axis=-1)
  names = tuple(f"turn {k}" for k in range(6))
  return Segments(commands, np.zeros((6, len(START))), np.full(6, len(TIME)), 0.01, names, np.zeros(6))


@pytest.mark.parametrize("truth", [(0.25, -0.15), (-0.1, 0.4), (0.0, 0.3)])
def test_each_exponent_comes_back_where_both_have_moved(truth):
  twin = Twin(Vehicle.load(), select(["load_transfer"]), substeps=2, threads=1, engine="reduced")
  segments, names = turns(), (*OPEN, "load_sensitivity", "friction_load_sensitivity")
  free, columns = ParameterSet(twin.parameters[n] for n in names), [twin.parameters.index(n) for n in names]

  def shown(values: np.ndarray) -> np.ndarray:
    theta = np.tile(twin.parameters.nominal, (len(values), 1))
    theta[:, columns] = values
    signals = twin.rollout(theta, segments).signals
    scaled = [signals[..., SIGNALS.index(n)] / noise for n, noise in NOISE.items()]
    return np.stack(scaled, axis=-1).reshape(len(values), -1)

  hidden = free.vector(dict(zip(names[-2:], truth, strict=True)) | {"friction_coefficient": 0.7})
  noise = np.random.default_rng(7).standard_normal((1, shown(hidden[None]).size))
  measured = shown(hidden[None]) + noise
  found = fit(lambda values: shown(values) - measured, free, iterations=30)
  away = (found.theta - hidden)[-2:]
  assert np.all(np.abs(away) < 3.0 * found.std[-2:]), (found.named(), found.std)
  assert found.std[-2:].max() < 0.05  # each is known, and not only what they have in common
