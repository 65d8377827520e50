"""What the classes that a script imports have in common: the car, the clock, and what is noted on the way."""

import dataclasses

from qcar_twin.onboard.car import Car
from qcar_twin.onboard.clock import Clock

HANDED_OUT = 5e-6  # s, assumed, from a task's sample to whoever waits for it; at 0, a loop would see round times
READ_TIME = 5e-4  # s of an immediate reading, assumed: nobody has measured one on the car


@dataclasses.dataclass
class Rig:
  """One drive of a script.

  Attributes:
    car, clock: what is driven, and when.
    opened: QCars that the script made.  reads, writes: calls of them.
    ranged: looks at pose and lidar.
    oldest: age of the oldest reading that a task handed out, s.
  """

  car: Car
  clock: Clock
  opened: int = 0
  reads: int = 0
  writes: int = 0
  ranged: int = 0
  oldest: float = 0.0

  def notes(self) -> list[str]:
    """What a driver should know of how the script used the car, in sentences."""
    if not self.opened:
      return ["the script made no QCar, so nothing was driven"]
    notes = []
    if not self.reads and not self.ranged:
      notes.append(
        f"the script never read the car ({self.writes} writes): it drove blind; call read() in the loop, which with"
        " readMode=1 also keeps its rate"
      )
    if not self.writes:
      notes.append("the script never wrote to the car: it stood still; call write(throttle, steering)")
    if self.oldest > 0.1:
      notes.append(
        f"readings were up to {self.oldest:.2f} s old: the loop is slower than the rate it asked for, and a task hands"
        " out one sample after the other; lower frequency, or use readMode=0"
      )
    return notes
