"""One run of the rigid-body car, stepped by Exudyn (Runge-Kutta method of third order, 0.5 ms).

What is not Exudyn's: a motor current as a torque at the rear wheels, air drag as a force on the chassis, and the goal
of each hinge's position loop, by the linkage and within reach of the servo's amplifier. The IMU sits at the centre of
gravity of the car at rest, on the chassis: it feels gravity by roll and pitch. It shows the mean of a fine step.
"""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np

from ...laboratory.manoeuvres import PERIOD
from ..generator import FINE, Start
from .machine import HINGES, JOINTS, WHEELS, Machine, assembled, left_and_right
from .numbers import GRAVITY, HALF_TRACK, Numbers

STEP = PERIOD / FINE  # s
STEPS = 2  # of the integration in that: a contact brings a wheel's spin to what rolls at 1500 to 4000 1/s


class ExudynPlant:
  """A `Plant` of these numbers; gear: wheel speed / motor speed. Raises ValueError where they are impossible."""

  def __init__(self, numbers: Numbers, gear: float, steps: int = STEPS) -> None:
    numbers.check()
    self.numbers, self.gear, self.steps = numbers, gear, steps
    self.time = 0.0

  def start(self, start: Start) -> np.ndarray:
    """On its contacts as at rest, rolling straight, at the acceleration of a car that nothing drives."""
    self.machine = machine = assembled(self.numbers, start)
    exu = machine.exudyn
    self.time = 0.0
    self.settings = settings = exu.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.solverType = exu.DynamicSolverType.RK33
    settings.timeIntegration.explicit.computeEndOfStepAccelerations = False
    settings.timeIntegration.numberOfSteps = self.steps
    settings.timeIntegration.endTime = STEP
    settings.solution.file.write = False
    settings.show.computationTime = False
    self.solver = exu.MainSolverExplicit()
    self.solver.InitializeSolver(machine.system, settings)
    self.forces, self.goals = np.zeros(JOINTS), np.zeros(JOINTS)
    self.moved = np.array(machine.system.systemData.GetODE2Coordinates_t())
    first = self._signals(machine)
    first[6] -= self._coasting(start.speed)
    return first

  def advance(self, drive: float, steer: float) -> np.ndarray:
    """`drive`: motor current [A]. Raises ValueError where the integration fails or the car turns over."""
    return np.array([self._fine(float(drive), float(steer)) for _ in range(FINE)])

  def _coasting(self, speed: float) -> float:
    """Deceleration of the car and its wheels when they roll out [m/s^2]."""
    n = self.numbers
    lost = (4.0 * (n.dry + n.fading * speed / n.radius) + n.dragging) / n.radius + n.drag * speed**2
    return lost / (n.mass + 4.0 * n.wheel_spin / n.radius**2) if speed > 0.0 else 0.0

  def _fine(self, drive: float, steer: float) -> np.ndarray:
    n, machine = self.numbers, self.machine
    data = machine.system.systemData
    self.goals[list(HINGES)] = self._acted_on(data.GetODE2Coordinates(), steer)
    if n.drag > 0.0:
      speed = np.asarray(data.GetODE2Coordinates_t()[:2])
      self.forces[:2] = -n.drag * hypot(speed[0], speed[1]) * speed
    torque = n.per_ampere * drive
    self.forces[[WHEELS[2], WHEELS[3]]] = n.left_share * torque, (1.0 - n.left_share) * torque
    machine.system.SetObjectParameter(machine.tree, "jointForceVector", self.forces)
    machine.system.SetObjectParameter(machine.tree, "jointPositionOffsetVector", self.goals)
    self._step(machine)
    return self._signals(machine)

  def _acted_on(self, place: np.ndarray, steer: float) -> list[float]:
    """Goals of the hinges [rad], as far from where they are as the servo's amplifier answers to. By the loop's equation
    J q'' = P e - D q', it runs at `servo_rate` under an error e of that times its lag D / P, as it is amid a step."""
    n = self.numbers
    most = n.servo_rate * (n.servo + 0.5 * STEP)
    left, right = left_and_right(steer, n.ahead + n.behind, HALF_TRACK)
    wished = zip(HINGES, (left - n.toe, right + n.toe), strict=True)
    return [place[hinge] + min(max(goal - place[hinge], -most), most) for hinge, goal in wished]

  def _step(self, machine: Machine) -> None:
    """A fine step, whose end is the beginning of the next."""
    times, data, initial = self.settings.timeIntegration, machine.system.systemData, machine.exudyn.ConfigurationType
    times.startTime, times.endTime = self.time, self.time + STEP
    self.solver.InitializeSolverInitialConditions(machine.system, self.settings)
    if not self.solver.SolveSteps(machine.system, self.settings):
      raise ValueError("Exudyn could not integrate this car")
    self.time += STEP
    data.SetODE2Coordinates(data.GetODE2Coordinates(), initial.Initial)
    data.SetODE2Coordinates_t(data.GetODE2Coordinates_t(), initial.Initial)
    data.SetDataCoordinates(data.GetDataCoordinates(), initial.Initial)

  def _signals(self, machine: Machine) -> np.ndarray:
    """By SIGNALS; accelerations are the specific force along the chassis' axes."""
    data = machine.system.systemData
    q, v = np.array(data.GetODE2Coordinates()), np.array(data.GetODE2Coordinates_t())
    a, self.moved = (v - self.moved) / STEP, v
    if not abs(q[4]) + abs(q[5]) < 1.0:
      raise ValueError("the car of Exudyn turned over")
    yaw_cos, yaw_sin = cos(q[2]), sin(q[2])
    along, across = yaw_cos * a[0] + yaw_sin * a[1], yaw_cos * a[1] - yaw_sin * a[0]
    up = GRAVITY + a[3]
    pitch_cos, pitch_sin, roll_cos, roll_sin = cos(q[4]), sin(q[4]), cos(q[5]), sin(q[5])
    felt_up = pitch_sin * along + pitch_cos * up
    motor = 0.5 * (v[WHEELS[2]] + v[WHEELS[3]]) / self.gear
    return np.array([
      q[0], q[1], q[2], yaw_cos * v[0] + yaw_sin * v[1], yaw_cos * v[1] - yaw_sin * v[0],
      roll_cos * pitch_cos * v[2] - roll_sin * v[4],
      pitch_cos * along - pitch_sin * up, roll_cos * across + roll_sin * felt_up,
      motor, 0.5 * (q[HINGES[0]] + q[HINGES[1]]),
    ])  # fmt: skip
