"""Motor speeds that arrive late."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Mechanism, SensorError, Track
from qcar_twin.twin.mechanisms.elements import caught_up, replaced, shifted

_FILTER = 0.016  # s, stated prior: of first order, with a corner of 10 Hz


class EncoderLatency(Mechanism):
  """The motor speed shown is the one of a while ago (counts differenced over a window, a filter).

  Equation: y(t) = x(t - d) for motor_speed; counts differenced over a window w look like d = w / 2.
  Units: d s; parts of a period are interpolated.
  Source: Brown, Schneider and Mulligan, IEEE Trans. Industrial Electronics 39, 1992 (speed from encoder counts).
  Size: stated prior: 0.03 s is counts differenced over 0.06 s, by the equation above. A log's speed may be out of a
    filter, as of motion capture or a controller: one of first order with a corner of 10 Hz is 1 / (2 pi 10 Hz) late.
  Confounded with: drive_delay where no acceleration was recorded.
  """

  name = "encoder_latency"
  subsystem = "sensor"
  stage = "sensor"
  link = "clock"
  needs = ("speed",)
  signed = True
  sensor_errors = {"encoder_latency": SensorError(0.003, per_period=0.25, as_logged={"speed": _FILTER})}
  fitted_rank = 5
  parameters = (
    Parameter("encoder_latency", 0.0, -0.12, 0.15, "s", "d", null=0.0, typical=0.03, description="age of the speed"),
  )

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    return caught_up(start, rate, theta[:, 0], "velocity_x")

  def measure(self, theta: Array, track: Track) -> Array:
    return replaced(track, motor_speed=shifted(track.signal("motor_speed"), theta[:, :1] / track.period))
