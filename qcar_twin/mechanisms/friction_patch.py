"""A slippery place on the floor."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.mechanisms.elements import scale_grip
from qcar_twin.parameters import Parameter

EDGE = 0.1  # m: width over which the patch fades


class FrictionPatch(Mechanism):
  """A round patch of floor has less grip than the rest; each wheel feels it on its own.

  Equation: mu = mu_fitted (1 - x s), s = (1 - tanh((|p_wheel - p_0| - R) / 0.1 m)) / 2.
  Units: x -; p_0 = (x_0, y_0) and R m in the world frame; share -: part of the loss that stiffness takes.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, ch. 14 (tyre-road friction; split friction).
  Confounded with: friction_change where the place is passed once; the place has to be found from several starts.
  """

  name = "friction_patch"
  subsystem = "ground"
  stage = "contact"
  needs = ("pose_x",)
  symmetric = False
  varies = True
  bends = True
  parameters = (
    Parameter("friction_patch", 0.0, 0.0, 0.9, "-", "x", null=0.0, typical=0.4, description="relative loss"),
    Parameter("friction_patch_x", 0.0, -50.0, 50.0, "m", "x_0", std=3.0, description="centre"),
    Parameter("friction_patch_y", 0.0, -50.0, 50.0, "m", "y_0", std=3.0, description="centre"),
    Parameter("friction_patch_radius", 0.5, 0.1, 5.0, "m", "R", std=0.5, description="radius"),
    Parameter("friction_patch_stiffness", 0.5, 0.0, 1.0, "-", "share", description="share that stiffness takes"),
  )

  def starts(self) -> Sequence[Mapping[str, float]]:
    """Nine places of a room of 5 m."""
    return tuple(
      {"friction_patch_x": x, "friction_patch_y": y, "friction_patch_radius": 0.8}
      for x in (-1.5, 0.0, 1.5)
      for y in (-1.5, 0.0, 1.5)
    )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    car, (x, y, yaw) = context.car, context.pose.T
    cosine, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    ahead = np.array([car.cg_to_front, car.cg_to_front, -car.cg_to_rear, -car.cg_to_rear])
    left = 0.5 * car.track_width * np.array([1.0, -1.0, 1.0, -1.0])
    away_x = (x - theta[:, 1])[:, None] + cosine * ahead - sine * left  # (n, 4)
    away_y = (y - theta[:, 2])[:, None] + sine * ahead + cosine * left
    distance = np.sqrt(away_x * away_x + away_y * away_y)
    inside = 0.5 * (1.0 - np.tanh((distance - theta[:, 3:4]) / EDGE))
    scale_grip(model, -theta[:, :1] * inside, theta[:, 4:])
