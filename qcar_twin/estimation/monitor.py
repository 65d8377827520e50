"""Whether one car's encoder is believed: its speed against the one that the lidar's raw fixes tell."""

import dataclasses
import itertools
import math
import statistics

WINDOW = 10  # intervals between fixes over which speeds are compared, a second of lidar
SPACING = 0.08  # s, least time between fixes that are compared
SLACK = 0.1  # m/s by which lidar and encoder may differ, besides
RELATIVE_SLACK = 0.15  # of the speed: slip, wheel radius
NOISE_SLACK = 1.7  # fix standard deviations per interval: three of the median of ten differences
PERSISTENCE = 3  # comparisons in a row before the verdict changes


@dataclasses.dataclass(slots=True)
class SpeedWatch:
  """Encoder against lidar: the speed both tell over the last fixes.

  A stuck or slipping encoder is told from a wrong model by evidence the filter does not use: differences
  of raw fixes. Their median by component ignores spikes and a single jump of the position.

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
    """An independent copy."""
    return SpeedWatch(self.fixes, self.distance, self.doubted, self.contrary)

  def travel(self, speed: float, period: float) -> None:
    """Add one encoder sample, m/s held for `period` s."""
    self.distance += abs(speed) * period

  def compare(self, time: float, x: float, y: float, std: float) -> None:
    """Take a raw fix with its standard deviation, m, and settle whether the encoder is believed."""
    if self.fixes and time - self.fixes[-1][0] < SPACING:
      return
    self.fixes = (*self.fixes[-WINDOW:], (time, x, y, self.distance))
    if len(self.fixes) <= WINDOW:
      return
    steps = [(b[0] - a[0], b[1] - a[1], b[2] - a[2], b[3] - a[3]) for a, b in itertools.pairwise(self.fixes)]
    interval = statistics.median(step[0] for step in steps)
    vx, vy, said = (statistics.median(step[i] / step[0] for step in steps) for i in (1, 2, 3))
    spread = statistics.median(math.hypot(step[1] / step[0] - vx, step[2] / step[0] - vy) for step in steps)
    if spread > SLACK + 2.0 * NOISE_SLACK * std / interval:
      self.contrary = 0  # the fixes do not agree among themselves: they are no witness
      return
    seen = math.hypot(vx, vy)
    slack = SLACK + RELATIVE_SLACK * max(seen, said) + NOISE_SLACK * std / interval
    disagree = abs(seen - said) > slack
    self.contrary = self.contrary + 1 if disagree != self.doubted else 0
    if self.contrary >= PERSISTENCE:
      self.doubted, self.contrary = disagree, 0
