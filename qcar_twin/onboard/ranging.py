"""`QCarGPS` and `QCarLidar`: a pose that comes ten times a second and late, and a scan of the walls of a hall."""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from qcar_twin.onboard.rig import Rig
from qcar_twin.sensors.lidar import Room, ScanningLidar, ScanningLidarRun

Array = NDArray[np.float64]
SCAN_PERIOD = 0.1  # s, a turn of the lidar
HALL = 4.0  # m from the start to each wall


class QCarGPS:
  """Pose by the lidar: `position` x, y, z [m] and `orientation` roll, pitch, yaw [rad], yaw within half a turn.

  Args:
    initialPose: x, y [m], yaw [rad] of the car when it is made: the simulated car is put there, or, where it has been
      driven already, the pose is counted from there.
    calibrate: is not needed; nor are ports, nor whether a lidar is attached.
  """

  rig: ClassVar[Rig]

  def __init__(
    self,
    initialPose: Sequence[float] = (0, 0, 0),
    calibrate: bool = False,
    gpsPort: int = 18967,
    lidarIdealPort: int = 18968,
    attach_lidar: bool = True,
  ):
    x, y, yaw = (float(value) for value in np.asarray(initialPose, dtype=float).reshape(3))
    self._taken, self._turn, self._shift = 0, 0.0, np.zeros(2)
    if not self.rig.car.begun:
      self.rig.car.place(x, y, yaw)
    else:
      here = self.rig.car.pose
      self._turn = yaw - here[2]
      self._shift = np.array([x, y]) - _rotation(self._turn) @ np.array(here[:2])
    self.position, self.orientation = np.array([x, y, 0.0]), np.array([0.0, 0.0, yaw])
    self._lidar: QCarLidar | None = None
    self.angles, self.distances = np.zeros(0), np.zeros(0)

  def readGPS(self) -> bool:
    """Take the newest pose that has arrived; whether there was a new one."""
    self.rig.clock.read()
    self.rig.ranged += 1
    arrived = self.rig.car.fixes
    if len(arrived) == self._taken:
      return False
    self._taken, fix = len(arrived), arrived[-1]
    self.position[:2] = _rotation(self._turn) @ np.array([fix.x, fix.y]) + self._shift
    self.orientation[2] = math.remainder(fix.yaw + self._turn, math.tau)
    return True

  def readLidar(self) -> bool:
    """Take a new scan into `angles` and `distances`, if there is one; never waits for it."""
    self.rig.clock.read()
    if self._lidar is None:
      self._lidar = type("QCarLidar", (QCarLidar,), {"rig": self.rig})()
    if self.rig.clock.now < self._lidar.due:
      return False
    self._lidar.read()
    self.angles, self.distances = self._lidar.angles, self._lidar.distances
    return True

  def terminate(self) -> None:
    """Nothing is to be let go of."""

  def __enter__(self) -> "QCarGPS":
    return self

  def __exit__(self, *_: object) -> None:
    self.terminate()


def _rotation(angle: float) -> Array:
  cos, sin = math.cos(angle), math.sin(angle)
  return np.array([[cos, -sin], [sin, cos]])


class QCarLidar:
  """A scan of a square hall without furniture around the car's start.

  Args:
    numMeasurements: beams of a scan.  The other settings of the real one make no difference.

  Attributes:
    angles: rad, clockwise seen from above, from the car's tail, (n,): pi is ahead.
    distances: m, (n,); 0 where nothing came back.
    due: when the next scan is complete, s.
  """

  rig: ClassVar[Rig]

  def __init__(
    self,
    numMeasurements: int = 384,
    rangingDistanceMode: int = 2,
    interpolationMode: int = 0,
    interpolationMaxDistance: float = 0,
    interpolationMaxAngle: float = 0,
    enableFiltering: bool = True,
    angularResolution: float = math.radians(1.0),
    type: str = "RPLidar",
  ):
    self.numMeasurements, car = numMeasurements, self.rig.car
    x, y, _ = car.pose
    room = Room.around(np.array([x]), np.array([y]), margin=HALL)
    walls = Room(room.boxes[:4])
    lidar = ScanningLidar(walls, beams=numMeasurements)
    self._run = ScanningLidarRun(lidar, 1, np.random.default_rng([car.seed, 3]))
    self.due = self.rig.clock.now
    self.angles = np.arange(numMeasurements) * math.tau / numMeasurements
    self.distances = np.zeros(numMeasurements)

  def read(self) -> bool:
    """Wait for the next turn of the lidar and take its scan."""
    clock = self.rig.clock
    self.rig.ranged += 1
    clock.sleep_until(max(self.due, clock.now))
    self.due += (math.floor((clock.now - self.due) / SCAN_PERIOD + 1e-9) + 1) * SCAN_PERIOD
    scan = self._run.scan(np.array([self.rig.car.pose]))[0]  # beam i points at 2 pi i / n, counter-clockwise from ahead
    order = np.round((math.pi - self.angles) / math.tau * self.numMeasurements).astype(int) % self.numMeasurements
    self.distances = np.nan_to_num(scan[order])
    return True

  def terminate(self) -> None:
    """Nothing is to be let go of."""

  def __enter__(self) -> "QCarLidar":
    return self

  def __exit__(self, *_: object) -> None:
    self.terminate()
