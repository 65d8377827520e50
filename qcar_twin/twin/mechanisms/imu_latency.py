"""IMU data that arrive late."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Mechanism, SensorError, Track
from qcar_twin.twin.mechanisms.elements import caught_up, replaced, shifted


class ImuLatency(Mechanism):
  """What the IMU shows happened a while ago (filter, bus, driver).

  Equation: y(t) = x(t - d) for yaw_rate, accel_x and accel_y.
  Units: d s; parts of a period are interpolated.
  Source: Furgale, Rehder and Siegwart, IROS 2013 (temporal calibration of sensors).
  Size: stated prior: 0.05 s is the slowest low-pass of an MPU-6050 (InvenSense, product specification 3.4, 2013), 19
    ms at 5 Hz, and a bus and a driver of three control periods of 10 ms.
  Confounded with: steering_delay, steering_lag, where no pose was recorded.
  """

  name = "imu_latency"
  subsystem = "sensor"
  stage = "sensor"
  link = "clock"
  needs = ("yaw_rate",)
  signed = True
  # half a period of an IMU read at 100 Hz: no log says whether its samples are means of a period or its last one
  sensor_errors = {"imu_latency": SensorError(0.005, per_period=0.25)}
  fitted_rank = 11
  parameters = (
    Parameter("imu_latency", 0.0, -0.12, 0.25, "s", "d", null=0.0, typical=0.05, description="age of the data"),
  )

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    return caught_up(start, rate, theta[:, 0], "velocity_y", "yaw_rate")

  def measure(self, theta: Array, track: Track) -> Array:
    late = theta[:, :1] / track.period
    names = ("yaw_rate", "accel_x", "accel_y")
    return replaced(track, **{name: shifted(track.signal(name), late) for name in names})
