"""What the motor does with its command and speed, as curves of no known form."""

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage, polyline

_PUSH, _BRAKE = np.array([0.0, 0.125, 0.25, 0.5, 0.75, 1.0]), np.array([0.0, 0.5, 1.0])
_REST = 0.03  # share of the largest command below which a driver takes it for none


class DriveCurve(Mechanism):
  """The motor's torque is a free curve of the command, less the back-EMF by a free share of the command.

  Equation: V = u + sgn(u) U sum_k a_k h_k(|u| / U) + e (b_r max(1 - |u| / 0.03 U, 0) + sum_j b_j h_j(|u| / U)), h hats,
  held beyond U; e the back-EMF; the torque is proportional to V - e, so b = 1 is a motor that does not brake at that
  command, and no sum is more. What a driver does without any command is its own matter, with a number of its own, b_r.
  Units: a_k - (shares of U), b_j, b_r -, U V, the largest command driven; u, V, e V.
  Source: hat functions, de Boor, A Practical Guide to Splines, Springer, 2001, ch. III (piecewise linear).
  Size: stated prior: 0.05 of the largest command and 0.25 of the braking, five and four points of the curve that a
    driver's map may bend.
  Confounded with: every named error of the drive's map, which it is there to outline.
  """

  name = "drive_curve"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  drives = ("voltage", "duty")
  absorbed_by_drive = True
  signed = True
  curve = True
  parameters = (
    *(
      Parameter(f"drive_push_{i}", 0.0, -0.8, 0.8, "-", f"a_{i}", null=0.0, typical=0.05, description="torque")
      for i in range(1, len(_PUSH))
    ),
    *(
      Parameter(f"drive_brake_{i}", 0.0, -2.0, 1.0, "-", f"b_{i}", null=0.0, typical=0.25, description="braking")
      for i in range(len(_BRAKE))
    ),
    Parameter("drive_brake_rest", 0.0, -2.0, 1.0, "-", "b_r", null=0.0, typical=0.25, description="braking at rest"),
    Parameter("drive_curve_reach", 2.0, 0.1, 100.0, "V", "U", std=1e-3, description="largest command"),
  )

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    voltage, reach, last = command[:, 0], theta[:, -1], len(_PUSH) - 1
    share = np.abs(voltage) / reach
    push = np.zeros((len(theta), len(_PUSH)))
    push[:, 1:] = theta[:, :last]
    acting = command.copy()
    acting[:, 0] += np.sign(voltage) * reach * polyline(share, _PUSH, push)
    braking = polyline(share, _BRAKE, theta[:, last:-2]) + theta[:, -2] * np.maximum(1.0 - share / _REST, 0.0)
    acting[:, 0] += idle_voltage(context) * np.minimum(braking, 1.0)
    return acting
