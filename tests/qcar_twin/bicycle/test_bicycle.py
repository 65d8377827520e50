"""Bicycle as a Plant: signals, batches, starts, the IMU's place, and refusals by their text."""

from types import SimpleNamespace

import numpy as np
import pytest

from qcar_twin.bicycle import bicycle as module
from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle, TurningLosses
from qcar_twin.plant import COMMANDS, SIGNALS, START, Segments, signal_index
from qcar_twin.vehicle.drive import DRIVES

VEHICLE = SimpleNamespace(
  mass=2.7, yaw_inertia=0.030, cg_to_front=0.128, cg_to_rear=0.128, wheel_radius=0.033,
  gear_ratio=0.0953668, max_steering=0.5236, imu_x=0.05, imu_y=-0.02, motor=DRIVES["voltage"], commands=COMMANDS,
)  # fmt: skip
THETA = PARAMETERS.vector({"cornering_stiffness_front": 150.0, "cornering_stiffness_rear": 200.0})


def drive(steps=300, size=3, seed=0):
  """Segments with lively commands, one of them starting while moving."""
  generator = np.random.default_rng(seed)
  voltage = np.repeat(generator.uniform(-0.5, 3.0, (size, steps // 30)), 30, axis=1)
  steering = np.repeat(generator.uniform(-0.35, 0.35, (size, steps // 20)), 20, axis=1)
  start = np.zeros((size, len(START)))
  start[0] = [1.0, 2.0, 0.5, 1.0, 0.02, 0.3, 0.1]
  names = tuple(f"run_{k}" for k in range(size))
  return Segments(np.stack([voltage, steering], axis=-1), start, np.full(size, steps), 0.01, names, np.zeros(size))


def test_rollout_has_the_contract_shape_and_starts_at_the_start():
  segments = drive()
  prediction = Bicycle(VEHICLE).rollout(THETA, segments)
  assert prediction.signals.shape == (1, 3, 301, len(SIGNALS))
  for k, name in enumerate(START):
    np.testing.assert_allclose(prediction.channel(name)[0, :, 0], segments.start[:, k], atol=1e-15)


@pytest.mark.parametrize("losses", [TurningLosses(), TurningLosses(0.3, 80.0)])
@pytest.mark.parametrize("at_once", [20_000, 84])  # all 120 periods of the twelve cars at once, and 7 at a time
def test_batch_equals_single_runs(losses, at_once, monkeypatch):
  monkeypatch.setattr(module, "_AT_ONCE", at_once)
  segments, bicycle = drive(steps=120), Bicycle(VEHICLE, losses=losses)
  thetas = THETA * np.random.default_rng(1).uniform(0.7, 1.4, (4, len(THETA)))
  batch = bicycle.rollout(thetas, segments).signals
  for i, theta in enumerate(thetas):
    for s in range(len(segments)):
      simulation = bicycle.begin(theta, segments.start[s])
      single = [simulation.signals[0]] + [simulation.step(u[None])[0] for u in segments.commands[s]]
      np.testing.assert_allclose(batch[i, s], single, rtol=1e-12, atol=1e-12)


def test_signals_are_consistent_with_each_other():
  """Velocity is the derivative of position, yaw rate of yaw, and the motor turns with the car."""
  segments = drive(steps=300)
  fine = Bicycle(VEHICLE, period=0.001)
  commands = np.repeat(segments.commands[:, :40], 10, axis=1)
  short = Segments(commands, segments.start, np.full(3, 400), 0.001, segments.recording, segments.offset)
  p = fine.rollout(THETA, short)
  rate = np.gradient(p.channel("pose_yaw")[0], 0.001, axis=-1)
  held = np.ones(401, dtype=bool)
  held[::100], held[1::100], held[-2:], held[:2] = False, False, False, False
  np.testing.assert_allclose(rate[:, held], p.channel("yaw_rate")[0][:, held], atol=0.02)
  yaw, vx, vy = (p.channel(n)[0] for n in ("pose_yaw", "velocity_x", "velocity_y"))
  np.testing.assert_allclose(
    np.gradient(p.channel("pose_x")[0], 0.001, axis=-1)[:, held],
    (vx * np.cos(yaw) - vy * np.sin(yaw))[:, held], atol=0.02,
  )  # fmt: skip
  speed = np.sign(vx) * np.hypot(vx, vy)
  np.testing.assert_allclose(speed, p.channel("motor_speed")[0] * 0.0953668 * 0.033, atol=1e-12)


def test_imu_feels_the_acceleration_of_its_own_place():
  """accel_x, accel_y against the second derivative of the IMU's simulated path."""
  period = 0.001
  commands = np.zeros((1, 400, 2)) + [2.0, 0.25]
  start = np.array([[0.0, 0.0, 0.0, 1.2, 0.0, 0.0, 0.0]])
  segments = Segments(commands, start, np.array([400]), period, ("turn",), np.zeros(1))
  p = Bicycle(VEHICLE, period=period).rollout(THETA, segments)
  x, y, yaw = (p.channel(n)[0, 0] for n in ("pose_x", "pose_y", "pose_yaw"))
  imu = np.array([x + 0.05 * np.cos(yaw) + 0.02 * np.sin(yaw), y + 0.05 * np.sin(yaw) - 0.02 * np.cos(yaw)])
  second = (imu[:, 2:] - 2 * imu[:, 1:-1] + imu[:, :-2]) / period**2
  cos, sin = np.cos(yaw[1:-1]), np.sin(yaw[1:-1])
  body = np.array([cos * second[0] + sin * second[1], -sin * second[0] + cos * second[1]])
  felt = np.array([p.channel("accel_x")[0, 0, 1:-1], p.channel("accel_y")[0, 0, 1:-1]])
  np.testing.assert_allclose(felt[:, 20:], body[:, 20:], atol=0.02)
  assert np.abs(felt[1]).max() > 3.0


def test_mirrored_commands_give_mirrored_signals():
  segments = drive()
  mirror = np.array([-1.0 if n in {"pose_y", "pose_yaw", "velocity_y", "yaw_rate", "accel_y", "steering_angle"}
                     else 1.0 for n in SIGNALS])  # fmt: skip
  flip = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0])
  centred = SimpleNamespace(**{**vars(VEHICLE), "imu_y": 0.0})
  other = Segments(
    segments.commands * [1.0, -1.0], segments.start * flip, segments.steps, 0.01, segments.recording, segments.offset
  )
  here, there = (Bicycle(centred).rollout(THETA, s).signals for s in (segments, other))
  np.testing.assert_allclose(there, here * mirror, atol=1e-11)


def test_steering_ends_at_its_stop():
  simulation = Bicycle(VEHICLE).begin(THETA, np.zeros(len(START)))
  assert simulation.step(np.array([[1.0, 2.0]]))[0, signal_index("steering_angle")] == VEHICLE.max_steering


def test_standstill_and_reverse_are_finite_and_calm():
  simulation = Bicycle(VEHICLE).begin(THETA, np.zeros(len(START)))
  for _ in range(20):
    rest = simulation.step(np.array([[0.1, 0.3]]))
  assert np.all(rest[0, :9] == 0.0)
  for _ in range(200):
    back = simulation.step(np.array([[-1.5, 0.2]]))
  assert np.all(np.isfinite(back))
  assert back[0, signal_index("velocity_x")] < -0.3
  assert back[0, signal_index("yaw_rate")] < 0.0  # backwards with the wheels to the left


def test_wrong_shapes_are_refused_with_the_cure():
  bicycle = Bicycle(VEHICLE)
  with pytest.raises(ValueError, match="expected 5 parameters"):
    bicycle.begin(np.ones(4), np.zeros(7))
  with pytest.raises(ValueError, match=r"start must be \(1, 7\)"):
    bicycle.begin(THETA, np.zeros(6))
  segments = drive()
  slow = Segments(segments.commands, segments.start, segments.steps, 0.02, segments.recording, segments.offset)
  with pytest.raises(ValueError, match="resample"):
    bicycle.rollout(THETA, slow)
  assert "drive_gain" in repr(bicycle)
