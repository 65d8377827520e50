"""What a recording may hold: one record per channel, and nothing about a channel anywhere else.

The loader, the checks of units and faults, the noise model, the simulated sensors and the table in
docs/reference/recordings.md all read it here. A channel of your own is one more record:
`register(Channel("roll_rate", ...))`.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

Kind = Literal["clock", "command", "sensor", "quality"]
GRAVITY = 9.80665  # m/s^2, standard gravity: what accelerometers call 1 g
_DEGREES = ("degrees", math.pi / 180.0)
_DEG_PER_S = ("deg/s", math.pi / 180.0)
_RPM = ("rpm", math.tau / 60.0)
_ACCELERATION = (("g", GRAVITY), ("mg", GRAVITY / 1000.0))
_SPEED = (("km/h", 1 / 3.6), ("cm/s", 0.01), ("mm/s", 0.001))
_LENGTH = (("mm", 0.001), ("cm", 0.01))


@dataclass(frozen=True)
class Channel:
  """A quantity a recording may hold, in SI units with ISO 8855 signs.

  Attributes:
    name: canonical; a log column of this name is read without being mapped.
    unit: SI.
    description: what it is and where positive points.
    kind: "clock"; "command" keeps its value until the next sample; "sensor" is interpolated; "quality" is what a sensor
      says of itself, and no noise is asked of it.
    device: sensor or actuator it belongs to.
    limit: largest magnitude that a 1:10 car can show; a log beyond it is refused as being in another unit.
    spikes: share of a sensor's samples that may lie beyond the limit; of a command none may.
    log_units: units it is often logged in by mistake, with the factor to SI.
    noise: typical standard deviation of one sample while the car drives; NaN where it says little.
    angle: it grows beyond half a turn, so a log that jumps there must be unwrapped.
    noisy: its noise never lets it repeat one value exactly for long, so a value that stays is a fault.
    clips: its range is one that a hard drive can exceed.
  """

  name: str
  unit: str
  description: str
  kind: Kind = "sensor"
  device: str = ""
  limit: float = math.inf
  spikes: float = 0.005
  log_units: tuple[tuple[str, float], ...] = ()
  noise: float = math.nan
  angle: bool = False
  noisy: bool = False
  clips: bool = False

  def __post_init__(self) -> None:
    if not self.name.isidentifier() or not self.unit or not self.description:
      raise ValueError(f"a channel needs a name of letters, digits and _, a unit and a description, not {self}")
    if self.kind not in get_args(Kind):
      raise ValueError(f"channel '{self.name}': no kind '{self.kind}'; there are {', '.join(get_args(Kind))}")
    if not self.limit > 0.0 or not 0.0 <= self.spikes < 1.0 or self.noise < 0.0:
      raise ValueError(f"channel '{self.name}': limit must be positive, spikes a share, noise no less than 0")
    if self.limit < math.inf and not self.log_units:
      raise ValueError(f"channel '{self.name}': a limit needs log_units, the cure that an error offers")
    if not all(scale > 0.0 for _, scale in self.log_units):
      raise ValueError(f"channel '{self.name}': factors of log_units must be positive")

  @property
  def is_command(self) -> bool:
    """Whether it was commanded: it keeps its value until the next sample, and a NaN in it is an error."""
    return self.kind == "command"

  @property
  def is_measured(self) -> bool:
    """Whether a sensor says it, of the car or of itself."""
    return self.kind in ("sensor", "quality")


CHANNELS: dict[str, Channel] = {
  channel.name: channel
  for channel in (
    Channel("time", "s", "strictly increasing within a recording", "clock"),
    Channel(
      "motor_voltage", "V", "commanded armature voltage", "command", "motor", limit=100.0, log_units=(("mV", 0.001),)
    ),
    Channel(
      "motor_duty",
      "-",
      "commanded duty cycle, share of the battery's voltage",
      "command",
      "motor",
      limit=1.1,
      log_units=(("per cent", 0.01), ("steps of 8 bits", 1.0 / 255.0)),
    ),
    Channel(
      "motor_current", "A", "commanded motor current", "command", "motor", limit=400.0, log_units=(("mA", 0.001),)
    ),
    Channel("speed_command", "m/s", "commanded vehicle speed", "command", "motor", limit=30.0, log_units=_SPEED),
    Channel(
      "acceleration_command",
      "m/s^2",
      "commanded acceleration along the car",
      "command",
      "motor",
      limit=160.0,
      log_units=_ACCELERATION,
    ),
    Channel(
      "steering_command",
      "rad",
      "commanded road-wheel angle, left positive",
      "command",
      "servo",
      limit=1.6,
      log_units=(_DEGREES,),
    ),
    Channel(
      "motor_speed",
      "rad/s",
      "motor-side speed from the encoder",
      "sensor",
      "encoder",
      limit=12000.0,
      log_units=(_RPM,),
      clips=True,
    ),
    Channel(
      "speed",
      "m/s",
      "vehicle speed where the log has no motor speed",
      "sensor",
      "encoder",
      limit=30.0,
      log_units=_SPEED,
      clips=True,
    ),
    Channel(
      "accel_x",
      "m/s^2",
      "IMU specific force, forward",
      "sensor",
      "imu",
      limit=160.0,
      log_units=_ACCELERATION,
      noise=0.15,
      noisy=True,
      clips=True,
    ),
    Channel(
      "accel_y",
      "m/s^2",
      "IMU specific force, left",
      "sensor",
      "imu",
      limit=160.0,
      log_units=_ACCELERATION,
      noise=0.15,
      noisy=True,
      clips=True,
    ),
    Channel(
      "yaw_rate",
      "rad/s",
      "gyro, counter-clockwise positive",
      "sensor",
      "imu",
      limit=15.0,
      log_units=(_DEG_PER_S,),
      noise=0.01,
      noisy=True,
      clips=True,
    ),
    Channel("pose_x", "m", "absolute position from lidar or motion capture", "sensor", "lidar", log_units=_LENGTH),
    Channel("pose_y", "m", "absolute position from lidar or motion capture", "sensor", "lidar", log_units=_LENGTH),
    Channel(
      "pose_yaw",
      "rad",
      "absolute heading, counter-clockwise positive",
      "sensor",
      "lidar",
      log_units=(_DEGREES,),
      angle=True,
    ),
    Channel("pose_score", "-", "the lidar software's own quality score", "quality", "lidar"),
    Channel(
      "battery_voltage",
      "V",
      "battery terminal voltage",
      "sensor",
      "battery",
      limit=100.0,
      spikes=0.0,
      log_units=(("mV", 0.001),),
    ),
    Channel(
      "armature_current",
      "A",
      "measured motor current",
      "sensor",
      "motor",
      limit=400.0,
      log_units=(("mA", 0.001),),
      noisy=True,
      clips=True,
    ),
  )
}
COMMANDS = ("motor_voltage", "steering_command")  # V, rad; of a car whose drive takes a voltage
DRIVE_COMMANDS = tuple(c.name for c in CHANNELS.values() if c.is_command and c.device == "motor")
# those with which a speed goes; a current and an acceleration set a force
SPEED_SETTING = tuple(c for c in DRIVE_COMMANDS if c not in ("motor_current", "acceleration_command"))


def register(channel: Channel) -> Channel:
  """Let recordings hold one more channel, and return its record.

  Raises:
    ValueError: another channel has its name.
  """
  if CHANNELS.setdefault(channel.name, channel) != channel:
    raise ValueError(f"there is a channel '{channel.name}' already; give the new one another name")
  return channel


def channels_of(kind: Kind) -> tuple[str, ...]:
  """Names of the channels of one kind, in canonical order."""
  return tuple(name for name, channel in CHANNELS.items() if channel.kind == kind)
