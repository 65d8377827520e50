"""Places of a car's named parts in a compiled MuJoCo model."""

import dataclasses

import mujoco

from qcar_twin.vehicle.vehicle import WHEELS


@dataclasses.dataclass(frozen=True)
class Handles:
  """Places of the car's named parts in a compiled model.

  Attributes:
    chassis: body id.  wheels: geom ids, (4,).  spin_dofs, suspension_dofs: (4,).
    steering_qpos: qpos addresses of the two knuckles, (2,).  motor_dof: int.
    motor, steering: control addresses.  accelerometer, gyro, encoder: addresses in sensordata.
  """

  chassis: int
  wheels: tuple[int, ...]
  spin_dofs: tuple[int, ...]
  suspension_dofs: tuple[int, ...]
  steering_qpos: tuple[int, ...]
  motor_dof: int
  motor: int
  steering: int
  accelerometer: int
  gyro: int
  encoder: int

  @classmethod
  def of(cls, model: mujoco.MjModel, prefix: str = "") -> "Handles":
    """Handles of the car whose names carry `prefix`, as after MjSpec.attach."""
    dof = lambda name: int(model.joint(prefix + name).dofadr[0])
    sensor = lambda name: int(model.sensor(prefix + name).adr[0])
    return cls(
      chassis=model.body(prefix + "chassis").id,
      wheels=tuple(model.geom(prefix + wheel).id for wheel in WHEELS),
      spin_dofs=tuple(dof(f"{wheel}_spin") for wheel in WHEELS),
      suspension_dofs=tuple(dof(f"{wheel}_suspension") for wheel in WHEELS),
      steering_qpos=tuple(int(model.joint(f"{prefix}{wheel}_steering").qposadr[0]) for wheel in WHEELS[:2]),
      motor_dof=dof("motor"),
      motor=int(model.actuator_ctrladr[model.actuator(prefix + "motor").id]),
      steering=int(model.actuator_ctrladr[model.actuator(prefix + "steering").id]),
      accelerometer=sensor("accelerometer"),
      gyro=sensor("gyro"),
      encoder=sensor("encoder"),
    )
