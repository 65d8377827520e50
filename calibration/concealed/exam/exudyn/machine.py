"""The car as Exudyn's parts: one tree of joints, a rolling disc per wheel, friction and stops in the joints.

Joints in order: the chassis' place x, y, its yaw, heave, pitch and roll; then left and right front hinge each with its
wheel behind it, and the rear wheels. The tree's equations of motion, the discs' forces, friction in the bearings, the
position loop of the hinges with their stops, and the integration are Exudyn's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..generator import Start, load_package
from .numbers import GRAVITY, HALF_TRACK, HINGE, HINGE_INERTIA, WHEEL, WHEEL_ACROSS, Numbers

PACKAGE = "exudyn"
CHASSIS_JOINTS = 6
HINGES, WHEELS = (6, 8), (7, 9, 10, 11)  # joints; wheels front left, front right, rear left, rear right
JOINTS = 12
_CREEP = 0.1  # rad/s of a bearing, from which on its friction is full; more of it where friction is so strong that
_FASTEST = 1000.0  # 1/s is what it would stop a wheel at, which steps of 1 ms still follow
_STOP, _STOP_DAMPING = 60.0, 0.1  # N m/rad, N m s/rad of the hinges' stops


@dataclass(frozen=True)
class Machine:
  """An assembled car.

  Attributes:
    exudyn: the package.  container: of the system, which it keeps alive.  system: Exudyn's `MainSystem`.
    tree: number of its kinematic tree.  discs: numbers of the wheels' contacts.
  """

  exudyn: Any
  container: Any
  system: Any
  tree: int
  discs: tuple[int, ...]


def left_and_right(steer: float, base: float, half_track: float) -> tuple[float, float]:
  """Angles of the front wheels [rad] of a mean angle, apart as two that are aimed at one turning centre (Ackermann)."""
  ahead = np.tan(steer)
  left, right = (np.arctan2(base * ahead, base - side * half_track * ahead) for side in (1.0, -1.0))
  return steer + 0.5 * float(left - right), steer - 0.5 * float(left - right)


def assembled(numbers: Numbers, start: Start) -> Machine:
  """The car at rest on its contacts, rolling straight. Raises MissingGenerator where Exudyn is not installed."""
  exu, items = load_package("exudyn", PACKAGE), load_package("exudyn.itemInterface", PACKAGE)
  container = exu.SystemContainer()
  system = container.AddSystem()
  place, speed = _initial(numbers, start)
  node = system.AddNode(
    items.NodeGenericODE2(
      referenceCoordinates=[0.0] * JOINTS,
      initialCoordinates=list(place),
      initialCoordinates_t=list(speed),
      numberOfODE2Coordinates=JOINTS,
    )  # fmt: skip
  )
  tree = system.AddObject(_tree(exu, items, numbers, node))
  floor = system.AddMarker(items.MarkerBodyRigid(bodyNumber=system.AddObject(items.ObjectGround())))
  discs = tuple(system.AddObject(_disc(system, items, numbers, tree, floor, i)) for i in range(4))
  _joint_friction(system, items, numbers, node)
  system.Assemble()
  return Machine(exu, container, system, tree, discs)


def _initial(n: Numbers, start: Start) -> tuple[np.ndarray, np.ndarray]:
  """Coordinates and their rates: on contacts that carry the static load, wheels that turn with the floor."""
  base = n.ahead + n.behind
  front, rear = _sinking(n)
  place, speed = np.zeros(JOINTS), np.zeros(JOINTS)
  pitch = (front - rear) / base
  place[:6] = start.x, start.y, start.yaw, -rear - n.behind * pitch, pitch, 0.0
  speed[:2] = start.speed * np.cos(start.yaw), start.speed * np.sin(start.yaw)
  speed[list(WHEELS)] = start.speed / n.radius
  return place, speed


def _sinking(n: Numbers) -> tuple[float, float]:
  """How deep a front and a rear wheel are in the floor under the static load, m."""
  front, rear = (0.5 * n.mass * GRAVITY * lever / (n.ahead + n.behind) for lever in (n.behind, n.ahead))
  return front / n.stiffness, rear / n.stiffness


def _tree(exu: Any, items: Any, n: Numbers, node: int) -> Any:
  joint = exu.JointType
  mass, centre = n.chassis
  none, own = np.zeros((3, 3)), np.diag([n.roll_inertia, n.pitch_inertia, n.yaw_inertia])
  wheel, hinge = np.diag([WHEEL_ACROSS, n.wheel_spin, WHEEL_ACROSS]), HINGE_INERTIA * np.eye(3)
  axle = n.radius - n.height
  front_left, front_right, rear_left, rear_right = ([x, y, axle] for x, y in n.hubs)
  here = [0.0, 0.0, 0.0]
  parts = [  # joint, parent, offset, mass, inertia, turned about z
    (joint.PrismaticX, -1, here, 0.0, none, 0.0),
    (joint.PrismaticY, 0, here, 0.0, none, 0.0),
    (joint.RevoluteZ, 1, here, 0.0, none, 0.0),
    (joint.PrismaticZ, 2, [0.0, 0.0, n.height], 0.0, none, 0.0),
    (joint.RevoluteY, 3, here, 0.0, none, 0.0),
    (joint.RevoluteX, 4, here, mass, own, 0.0),
    (joint.RevoluteZ, 5, front_left, HINGE, hinge, 0.0),
    (joint.RevoluteY, 6, here, WHEEL, wheel, 0.0),
    (joint.RevoluteZ, 5, front_right, HINGE, hinge, 0.0),
    (joint.RevoluteY, 8, here, WHEEL, wheel, 0.0),
    (joint.RevoluteY, 5, rear_left, WHEEL, wheel, 0.0),
    (joint.RevoluteY, 5, rear_right, WHEEL, wheel, n.bent),
  ]
  kinds, parents, offsets, masses, inertias, turns = zip(*parts, strict=True)
  gain, damping = _servo(n)
  return items.ObjectKinematicTree(
    nodeNumber=node, gravity=[0.0, 0.0, -GRAVITY], jointTypes=list(kinds), linkParents=list(parents),
    jointOffsets=exu.Vector3DList(list(offsets)), linkMasses=list(masses),
    jointTransformations=exu.Matrix3DList([_about_z(turn) for turn in turns]),
    linkInertiasCOM=exu.Matrix3DList(list(inertias)),
    linkCOMs=exu.Vector3DList([list(centre) if i == CHASSIS_JOINTS - 1 else here for i in range(JOINTS)]),
    jointForceVector=[0.0] * JOINTS, jointPositionOffsetVector=[0.0] * JOINTS,
    jointVelocityOffsetVector=[0.0] * JOINTS, jointPControlVector=list(gain), jointDControlVector=list(damping),
  )  # fmt: skip


def _servo(n: Numbers) -> tuple[np.ndarray, np.ndarray]:
  """Gains P [N m/rad] and D [N m s/rad] of the joints' loops: J q'' = P (goal - q) - D q', of lag D / P."""
  gain, damping = np.zeros(JOINTS), np.zeros(JOINTS)
  turned = WHEEL_ACROSS + HINGE_INERTIA
  fast = 2.0 * n.servo_damping / n.servo  # rad/s, undamped
  for hinge in HINGES:
    gain[hinge], damping[hinge] = turned * fast**2, turned * fast**2 * n.servo
  return gain, damping


def _disc(system: Any, items: Any, n: Numbers, tree: int, floor: int, wheel: int) -> Any:
  hub = system.AddMarker(
    items.MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=WHEELS[wheel], localPosition=[0.0, 0.0, 0.0])
  )
  gap = -_sinking(n)[wheel // 2]  # a disc that remembers none would carry nothing in its first step
  memory = system.AddNode(items.NodeGenericData(initialCoordinates=[0.0, 0.0, gap], numberOfDataCoordinates=3))
  grip = n.grip_left if wheel % 2 == 0 else n.grip_right
  return items.ObjectConnectorRollingDiscPenalty(
    markerNumbers=[floor, hub], nodeNumber=memory, discRadius=n.radius, discAxis=[0.0, 1.0, 0.0],
    planeNormal=[0.0, 0.0, 1.0], contactStiffness=n.stiffness, contactDamping=n.damping, dryFriction=[grip, grip],
    dryFrictionProportionalZone=n.zone_front if wheel < 2 else n.zone_rear,
  )  # fmt: skip


def _joint_friction(system: Any, items: Any, n: Numbers, node: int) -> None:
  """Bearings, what holds the rear wheels together, and the hinges' stops."""
  fixed = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0))
  of = {joint: system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=joint)) for joint in
        (*WHEELS, *HINGES)}  # fmt: skip

  def rubbing(one: int, other: int, force: float, fading: float, wheels: int = 1) -> None:
    system.AddObject(
      items.ObjectConnectorCoordinateSpringDamperExt(
        markerNumbers=[one, other],
        dynamicFrictionForce=force,
        viscousFrictionFactor=fading,
        frictionProportionalZone=max(_CREEP, wheels * force / (n.wheel_spin * _FASTEST)),
      )  # fmt: skip
    )

  for wheel in WHEELS:
    rubbing(fixed, of[wheel], n.dry + (n.dragging if wheel == WHEELS[3] else 0.0), n.fading)
  if n.preload > 0.0:
    rubbing(of[WHEELS[2]], of[WHEELS[3]], n.preload, 0.0, wheels=2)
  inner, outer = left_and_right(n.travel, n.ahead + n.behind, HALF_TRACK)
  for hinge, most, least in ((HINGES[0], inner, -outer), (HINGES[1], outer, -inner)):
    system.AddObject(
      items.ObjectConnectorCoordinateSpringDamperExt(
        markerNumbers=[fixed, of[hinge]],
        useLimitStops=True,
        limitStopsUpper=most,
        limitStopsLower=least,
        limitStopsStiffness=_STOP,
        limitStopsDamping=_STOP_DAMPING,
        frictionProportionalZone=_CREEP,
        nodeNumber=system.AddNode(items.NodeGenericData(initialCoordinates=[0.0] * 3, numberOfDataCoordinates=3)),
      )  # fmt: skip
    )


def _about_z(angle: float) -> np.ndarray:
  cos, sin = np.cos(angle), np.sin(angle)
  return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
