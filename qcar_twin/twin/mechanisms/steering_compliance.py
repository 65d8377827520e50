"""Steering that gives way under tyre force."""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.vehicle.vehicle import GRAVITY

NORMALISED_STIFFNESS = 22.0  # 1/rad: lateral force per axle load and slip angle, stiffer than any small tyre


class SteeringCompliance(Mechanism):
  """Side force on the front tyres turns the wheels back against the linkage.

  Equation: delta = u - c F_yf, with F_yf = (m a_y l_r + I_z r') / L from the car's own motion.
  Units: c rad/N, F_yf N. As a wheel turned back loses force within the same period, the next force is
  predicted with a nominal stiffness K: delta+ = (u - c F_yf + c K delta) / (1 + c K), which settles on
  the equation whatever K and doesn't oscillate.
  Source: Gillespie, Fundamentals of Vehicle Dynamics, SAE, 1992, ch. 8 (compliance steer).
  Size: stated prior: 0.008 rad/N is 2.5 deg at 4 m/s^2, where the front axle of 2.7 kg bears 5.4 N: a plastic linkage
    with a servo saver.
  Confounded with: front cornering stiffness, load_transfer.
  """

  name = "steering_compliance"
  subsystem = "steering"
  stage = "actuator"
  link = "play"
  parameters = (
    Parameter(
      "steering_compliance", 0.0, 0.0, 0.04, "rad/N", "c", null=0.0, typical=0.008, description="angle lost per force"
    ),
  )

  def initial(self, theta: Array, context: Context) -> State:
    return {"angle": context.signal("steering_angle").copy(), "yaw_rate": context.signal("yaw_rate").copy()}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    car, yaw_rate = context.car, context.signal("yaw_rate")
    yaw_acceleration = (yaw_rate - state["yaw_rate"]) / context.period
    lateral = context.signal("accel_y") - yaw_acceleration * car.imu_x + yaw_rate * yaw_rate * car.imu_y
    force = (car.mass * car.cg_to_rear * lateral + car.yaw_inertia * yaw_acceleration) / car.wheelbase
    stiffness = NORMALISED_STIFFNESS * car.mass * GRAVITY * car.cg_to_rear / car.wheelbase
    softness = theta[:, 0] * stiffness
    angle = (command[:, 1] - theta[:, 0] * force + softness * state["angle"]) / (1.0 + softness)
    state["angle"], state["yaw_rate"] = angle, yaw_rate.copy()
    acting = command.copy()
    acting[:, 1] = angle
    return acting
