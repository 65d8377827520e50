"""A slippery place on the floor."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import scale_grip

EDGE = 0.1  # m: width over which the patch fades
# m: side of the squares in whose middles a patch is sought, and how many squares may be needed for this share of the
# driving before larger ones are taken
SIDE, MOST, ENOUGH, LARGER = 0.8, 36, 0.9, 1.2


class FrictionPatch(Mechanism):
  """A round patch of floor has less grip than the rest; each wheel feels it on its own.

  Equation: mu = mu_fitted (1 - x s), s = (1 - tanh((|p_wheel - p_0| - R) / 0.1 m)) / 2.
  Units: x -; p_0 = (x_0, y_0) and R m in the world frame; share -: part of the loss that stiffness takes.
  Source: Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, ch. 14 (tyre-road friction; split friction).
  Size: stated prior: 0.4 takes the friction coefficient from 0.8 to about 0.5, a wet or polished place.
  Confounded with: friction_change where the place is passed once; the place has to be found from several starts.
  """

  name = "friction_patch"
  subsystem = "ground"
  stage = "contact"
  needs = ("pose_x",)
  symmetric = False
  varies = True
  nonlinear_response = True
  parameters = (
    Parameter("friction_patch", 0.0, 0.0, 0.9, "-", "x", null=0.0, typical=0.4, description="relative loss"),
    Parameter("friction_patch_x", 0.0, -50.0, 50.0, "m", "x_0", std=3.0, description="centre"),
    Parameter("friction_patch_y", 0.0, -50.0, 50.0, "m", "y_0", std=3.0, description="centre"),
    Parameter("friction_patch_radius", 0.5, 0.1, 5.0, "m", "R", std=0.5, description="radius"),
    Parameter("friction_patch_stiffness", 0.5, 0.0, 1.0, "-", "share", description="share that stiffness takes"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """The squares of a grid in which the car spent nine tenths of the driving, a patch that just covers each.

    A patch is seen from no further than its own size: a few fixed places would miss it.
    """
    if len(driving.places) == 0:
      return ({},)
    corner, side = driving.places.min(axis=0), SIDE
    while len(squares := _squares((driving.places - corner) / side)) > MOST:
      side *= LARGER
    _, place, _, size, _ = self.parameters
    middles = np.clip(corner + (squares + 0.5) * side, place.lower, place.upper)
    radius = min(0.75 * side, size.upper)
    return tuple(
      {"friction_patch_x": float(x), "friction_patch_y": float(y), "friction_patch_radius": radius} for x, y in middles
    )

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    car, (x, y, yaw) = context.car, context.pose.T
    cosine, sine = np.cos(yaw), np.sin(yaw)
    # a row per wheel until the end: operations along the cars are quicker than along four wheels
    ahead = np.array([[car.cg_to_front], [car.cg_to_front], [-car.cg_to_rear], [-car.cg_to_rear]])
    left = 0.5 * car.track_width * np.array([[1.0], [-1.0], [1.0], [-1.0]])
    away_x = x - theta[:, 1] + cosine * ahead - sine * left  # (4, n)
    away_y = y - theta[:, 2] + sine * ahead + cosine * left
    distance = np.sqrt(away_x * away_x + away_y * away_y)
    lost = -theta[:, 0] * (0.5 * (1.0 - np.tanh((distance - theta[:, 3]) / EDGE)))
    scale_grip(model, np.ascontiguousarray(lost.T), theta[:, 4:])


def _squares(places: Array) -> Array:
  """Lower corners of the fewest unit squares that hold enough of some places, (k, 2)."""
  corners, count = np.unique(np.floor(places), axis=0, return_counts=True)
  order = np.argsort(-count, kind="stable")
  held = np.cumsum(count[order]) / len(places)
  return corners[order[: 1 + int(np.searchsorted(held, ENOUGH))]]
