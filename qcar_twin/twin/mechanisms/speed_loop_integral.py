"""Speed controller that remembers its error, and lets go of the motor at low commands."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import EITHER, STANDSTILL, idle_voltage

# 1/s, stated priors: with a proportional part that takes T = 0.1 s the loop's damping ratio is 1/2 sqrt(1 / (r T))
_CRITICAL = 2.5  # a damping ratio of 1, where a search begins
_LIVELY = 10.0  # of 1/2, two standard deviations


class SpeedLoopIntegral(Mechanism):
  """The loop adds up what is missing of the speed, so that friction and drag are made up for and launches overshoot.

  Equation: T = a (u + z) - b w, z' = r (u - (b / a) w), |a z| <= T_max - h |a u - b w|: the proportional part leaves
    the integral that much of the limit. Where the car stands and is commanded to, z goes to (1 - q) z each period. A
    stretch begins with what the motion of the 0.2 s before took beyond u. At low commands a share p of T is none and so
    is as much of z: p = y / (1 + (u / u_0)^16), nearly a switch.
  Units: r 1/s, the integral gain over the proportional; h -, 1 where the integral gives way, 0 where it is only
    limited; q -, 1 where the loop forgets at rest; y -, 1 where it lets go below u_0, 0 where it brakes; u, u_0, z m/s;
    w rad/s of the motor; a N m s/m; b N m s/rad; T_max N m.
  Source: Åström and Hägglund, Advanced PID Control, 2006, ch. 3 (integral action, windup; PI control of a first-order
    process, of which the damping ratio is).
    VESC firmware, speed control (s_pid_min_erpm, 900 by default, which is 0.2 m/s of an F1TENTH: below it some
    versions let go and some brake).
  Size: stated prior: 10 1/s, with which a loop of 0.1 s has a damping ratio of 1/2; a search begins at a ratio of 1.
    Of y 0.5 is the middle of its range.
  Confounded with: less driveline friction, quadratic_drag, drive_lag.
  """

  name = "speed_loop_integral"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  drives = ("speed",)
  fitted_rank = 15
  whole = ("speed_loop_release",)
  parameters = (
    Parameter(
      "speed_loop_integral", 0.0, 0.0, 1.5 * _LIVELY, "1/s", "r", null=0.0, typical=_LIVELY, start=_CRITICAL,
      description="integral's rate",
    ),
    Parameter("speed_loop_giving_way", 1.0, 0.0, 1.0, "-", "h", std=0.5, description="gives way at the limit"),
    Parameter("speed_loop_forgetting", 1.0, 0.0, 1.0, "-", "q", std=0.5, description="of it is forgotten at rest"),
    Parameter(
      "speed_loop_release", 0.0, 0.0, 1.0, "-", "y", null=0.0, typical=0.5, description="letting go at low commands"
    ),
    Parameter("speed_loop_release_below", 0.2, 0.02, 0.8, "m/s", "u_0", description="commands that count as low"),
  )  # fmt: skip

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """A loop is stated without its gains, and rules of either kind are in use: every model fits all of them."""
    shares = {"speed_loop_giving_way": 0.5, "speed_loop_forgetting": 0.5, "speed_loop_release": EITHER}
    return {"speed_loop_integral": 0.5 * _LIVELY} | shares

  def initial(self, theta: Array, context: Context) -> State:
    told = {"told": np.full((len(theta), 2), np.nan), "held": np.full((len(theta), 2), np.nan)}
    if context.lead is None:
      return told | {"integral": np.zeros(len(theta))}
    command, motor_speed, taken, when = context.lead.T
    missed = command - context.motor_damping / context.torque_per_volt * motor_speed
    reached = taken - command - theta[:, 0] * missed * when
    return told | {"integral": self._limited(np.nan_to_num(reached), missed, theta, context)}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    idle = idle_voltage(context)
    told = np.column_stack([command[:, 0], state["told"]])  # now and in the two periods before
    told = np.where(np.isnan(told), command[:, :1], told)
    got, before = _mean_of_held(told, context), state["integral"]
    missed = got - idle
    rests = np.exp(-((context.signal("velocity_x") / STANDSTILL) ** 2) - (got / STANDSTILL) ** 2)
    grown = before * (1.0 - theta[:, 2] * rests) + theta[:, 0] * missed * context.period
    state["integral"] = self._limited(grown * (1.0 - _released(got, theta)), missed, theta, context)
    asked = told + 0.5 * (before + state["integral"])[:, None]
    asked += _released(told.T, theta).T * (idle[:, None] - asked)
    state["told"], state["held"] = told[:, :2], asked[:, 1:]
    acting = command.copy()
    acting[:, 0] = asked[:, 0]
    return acting

  def _limited(self, integral: Array, missed: Array, theta: Array, context: Context) -> Array:
    """What is left of the integral, m/s, where the motor's limit is near; `missed` of the speed, m/s."""
    room = np.maximum(context.max_torque / context.torque_per_volt - theta[:, 1] * np.abs(np.nan_to_num(missed)), 0.0)
    return np.clip(integral, -room, room)


def _released(command: Array, theta: Array) -> Array:
  """Share of the torque that is none at a command, m/s, (..., n)."""
  return theta[:, 3] / (1.0 + np.minimum(np.abs(command) / theta[:, 4], 1e3) ** 16)


def _mean_of_held(told: Array, context: Context) -> Array:
  """Mean over the period of what a loop is told, m/s, (n,): for a part of it still what it was told before, (n, 3)."""
  hold = context.drive_hold
  older, newest = np.clip(hold - 1.0, 0.0, 1.0), np.clip(1.0 - hold, 0.0, 1.0)
  return newest * told[:, 0] + (1.0 - older - newest) * told[:, 1] + older * told[:, 2]
