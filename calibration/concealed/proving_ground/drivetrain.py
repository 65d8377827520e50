"""Which axles the motor turns, and what the electronics before it are commanded."""

from __future__ import annotations

from dataclasses import dataclass

AXLES = {"all-wheel": (1.0, 1.0), "front": (1.0, 0.0), "rear": (0.0, 1.0)}
CHANNEL = {"voltage": "motor_voltage", "duty": "motor_duty", "current": "motor_current", "speed": "speed_command"}
STEP = {"voltage": 1e-3, "duty": 1e-4, "current": 1e-2, "speed": 1e-3}  # resolution of the commands, in car and log
LIMIT = {"voltage": 4.0, "duty": 0.8, "current": 40.0, "speed": 6.0}  # that the driver keeps to


@dataclass(frozen=True)
class Drivetrain:
  """What is driven, and by what. `command`: "voltage", "duty", "current" or "speed"."""

  layout: str = "all-wheel"
  command: str = "voltage"
  supply: float = 11.1  # V
  max_current: float = 60.0  # A
  proportional: float = 0.0  # A s/rad, of the speed loop
  integral: float = 0.0  # A/rad
  motor_per_speed: float = 0.0  # rad/m, as configured

  def __post_init__(self) -> None:
    if self.layout not in AXLES or self.command not in CHANNEL:
      raise ValueError(
        f"a drivetrain has layout {', '.join(AXLES)} and command {', '.join(CHANNEL)},"
        f" not {self.layout!r} and {self.command!r}"
      )

  def described(self) -> dict[str, float | str]:
    """What an owner knows of it, for the vehicle table; nothing of the one that every other car is compared with."""
    if self == Drivetrain():
      return {}
    known: dict[str, float | str] = {"layout": self.layout, "drive": self.command, "supply_voltage": self.supply}
    return known | ({} if self.command in ("voltage", "duty") else {"max_current": self.max_current})
