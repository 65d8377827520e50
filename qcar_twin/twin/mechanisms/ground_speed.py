"""A logged speed that is the car's own: motion capture, satellites or a fusion gave it, no wheel."""

from collections.abc import Mapping

from qcar_twin.kinematics import rolling_radius
from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Mechanism, Track
from qcar_twin.twin.mechanisms.elements import EITHER, replaced


class GroundSpeed(Mechanism):
  """The speed in the log is the car's own over ground, not that at which its wheels roll.

  Equation: speed = (1 - s) G r_w w + s v_x, with w of the motor; a filter that fuses both lies between.
  Units: s -: 0 is an encoder, 1 motion capture; w rad/s; v_x m/s, of the centre of gravity, forward.
  Source: Gustafsson, Automatica 33(6), 1997 (friction by slip): wheels that push turn faster than the car goes.
  Size: stated prior: 0.5 is the middle of the range from 0 to 1. Any is usual, so every model fits all of it, and no
    diagnosis names it.
  Confounded with: longitudinal stiffness, encoder_latency, where wheels slip little; the drive where no pose was
    logged, which is why it is left at none there.
  """

  name = "ground_speed"
  subsystem = "sensor"
  stage = "sensor"
  link = "axes"
  needs = ("speed", "pose_x")
  replaced_by = ("motor_speed",)
  fitted_rank = 27
  whole = ("ground_speed",)
  parameters = (
    Parameter(
      "ground_speed", 0.0, 0.0, 1.0, "-", "s", null=0.0, typical=0.5, description="the log's speed is the car's own"
    ),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Where a speed in a log comes from few descriptions of it say."""
    return {"ground_speed": EITHER}

  def own_share(self, theta: Array) -> Array:
    return theta[:, 0]

  def measure(self, theta: Array, track: Track) -> Array:
    share, own = theta[:, :1], track.signal("velocity_x") / rolling_radius(track.car)
    return replaced(track, motor_speed=(1.0 - share) * track.signal("motor_speed") + share * own)
