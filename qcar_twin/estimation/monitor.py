"""Bookkeeping that decides when a sensor is not believed, for one car."""

import dataclasses
import math

STEADY = 0.2  # m: refused fixes whose innovations stay this close to each other are no random spikes
WINDOW = 5  # fixes over which travelled distance is compared, half a second of lidar
SPEED_SLACK = (0.15, 0.25)  # m/s, and share of the speed: how far lidar and encoder may differ
PERSISTENCE = 3  # comparisons in a row before the verdict changes


@dataclasses.dataclass(slots=True)
class Monitor:
  """Lidar fixes refused in a row, and whether they tell the same story.

  Attributes:
    age: since the last accepted fix, s.
    refused: fixes refused in a row.
    steady: of those, how many agree with their predecessor on where the car is.
    dx, dy: last refused innovation, m.
  """

  age: float = 0.0
  refused: int = 0
  steady: int = 0
  dx: float = 0.0
  dy: float = 0.0

  def copy(self) -> "Monitor":
    return Monitor(self.age, self.refused, self.steady, self.dx, self.dy)

  def accept(self) -> None:
    self.age, self.refused, self.steady = 0.0, 0, 0

  def refuse(self, dx: float, dy: float) -> int:
    """Note a refused innovation, m; returns how many in a row have agreed."""
    agrees = self.refused > 0 and math.hypot(dx - self.dx, dy - self.dy) < STEADY
    self.steady = self.steady + 1 if agrees else 1
    self.refused, self.dx, self.dy = self.refused + 1, dx, dy
    return self.steady


@dataclasses.dataclass(slots=True)
class SpeedWatch:
  """Encoder against lidar: the distance both say was travelled over the last fixes.

  A stuck or slipping encoder is told from a wrong model by evidence the filter does not use: differences
  of raw fixes. One spiked fix disturbs two comparisons that are never in a row.

  Attributes:
    fixes: time s, x m, y m, encoder distance m, of the last fixes.
    distance: the encoder's, m.
    doubted: whether the encoder is left out at present.
    contrary: comparisons in a row that contradict `doubted`.
  """

  fixes: tuple[tuple[float, float, float, float], ...] = ()
  distance: float = 0.0
  doubted: bool = False
  contrary: int = 0

  def copy(self) -> "SpeedWatch":
    return SpeedWatch(self.fixes, self.distance, self.doubted, self.contrary)

  def travel(self, speed: float, period: float) -> None:
    """Add one encoder sample, m/s held for `period` s."""
    self.distance += abs(speed) * period

  def compare(self, time: float, x: float, y: float) -> None:
    """Take a raw fix and settle whether the encoder is believed."""
    self.fixes = (*self.fixes[-WINDOW:], (time, x, y, self.distance))
    if len(self.fixes) <= WINDOW:
      return
    then, x0, y0, gone = self.fixes[0]
    span = time - then
    seen, said = math.hypot(x - x0, y - y0) / span, (self.distance - gone) / span
    absolute, relative = SPEED_SLACK
    disagree = abs(seen - said) > absolute + relative * max(seen, said)
    self.contrary = self.contrary + 1 if disagree != self.doubted else 0
    if self.contrary >= PERSISTENCE:
      self.doubted, self.contrary = disagree, 0
