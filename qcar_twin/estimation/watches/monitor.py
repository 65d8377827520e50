"""Whether one car's encoder and the stamps of its fixes are believed.

The encoder is held against its own past, the filter, the accelerometer and the raw fixes; stamps against their beat.
"""

import copy
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
FALSE_ALARM = 1e-6  # probability of calling a sound encoder frozen, per sample
REMEMBERED = 200.0  # samples by which it is known how often a sound encoder repeats itself
REFUSALS = 3  # samples in a row beyond the filter's gate, each 1e-4 likely by chance, that suspend it
AGREEMENTS = 20  # samples in a row within the gate as it was before that bring it back
BEATS = 10  # stamps by which it is known that a lidar keeps its beat
COUNTS = 3.0  # steps of the encoder by which the command must have changed a speed that is called frozen
OFF_BEAT = 0.2  # of the interval between fixes, by which a stamp may miss the beat
COASTING = 0.5  # m/s^2, by which an accelerometer on a rolling, pitching car may be wrong for a while


@dataclasses.dataclass(slots=True)
class SpeedWatch:
  """Encoder against lidar: the speed both tell over the last fixes.

  A stuck or slipping encoder is distinguished from a wrong model by evidence the filter does not use: differences
  of raw fixes, turned back by what the gyro says the car has turned. Their median by component ignores spikes and a
  single jump of the position.

  Attributes:
    fixes: time s, x m, y m, encoder distance m, turned rad, of the last fixes.
    distance: the encoder's, m.
    doubted: whether the encoder is left out at present.
    contrary: comparisons in a row that contradict `doubted`.
    last, repeated: last sample, m/s, and how often it has been repeated since.
    count: smallest step between samples so far, m/s.
    push, pushed: of the drive command, when the last sample began, m/s^2; by how much it has changed the speed since.
    repeats, samples: how many of how many former samples repeated the one before, fading.
    refusals, agreements: samples in a row that the filter refused, and that agree with it while suspended.
    suspended: whether the filter's gate has refused it in a row.
    reach: m/s, of the gate at the first refusal.
    coasted: m/s, the last sample that was used and what the accelerometer has added since.  since: then, s.
  """

  fixes: tuple[tuple[float, ...], ...] = ()
  distance: float = 0.0
  doubted: bool = False
  contrary: int = 0
  last: float = math.nan
  count: float = math.inf
  push: float = math.nan
  pushed: float = 0.0
  repeated: int = 0
  repeats: float = 0.0
  samples: float = 0.0
  refusals: int = 0
  agreements: int = 0
  suspended: bool = False
  reach: float = 0.0
  coasted: float = math.nan
  since: float = 0.0

  def copy(self) -> "SpeedWatch":
    """An independent copy."""
    return copy.copy(self)

  @property
  def frozen(self) -> bool:
    """Whether it has repeated a sample other than zero more often than it ever would.

    A coarse encoder repeats itself often, a fine one hardly: its own past says how often, runs that have ended
    counted. At rest every encoder repeats its zero, and a speed that the command has not changed may well repeat.
    """
    likely = (self.repeats + 1.0) / (self.samples + 2.0)
    rare = self.repeated * math.log(likely) < math.log(FALSE_ALARM)
    return self.last != 0.0 and rare and not abs(self.pushed) < COUNTS * self.count

  @property
  def believed(self) -> bool:
    """Whether the filter may use it."""
    return not (self.doubted or self.suspended or self.frozen)

  def hear(self, sample: float, push: float = math.nan, period: float = 0.0) -> None:
    """Take a raw sample, m/s, after a period, s, with the acceleration that the drive command gives, m/s^2.

    The command's is NaN where it is not known: a repeated sample is then judged by the encoder's past alone.
    """
    if sample == self.last:
      self.repeated += 1
      self.pushed += (push - self.push) * period
      return
    if math.isfinite(self.last):
      self.count = min(self.count, abs(sample - self.last))
    self.push, self.pushed = push, 0.0
    faded = max(0.0, 1.0 - (self.repeated + 1) / REMEMBERED)
    self.repeats, self.samples = faded * self.repeats + self.repeated, faded * self.samples + self.repeated + 1
    self.last, self.repeated = sample, 0

  def coast(self, acceleration: float, period: float) -> None:
    """What the accelerometer, m/s^2 forward, says has become of the speed; NaN where there is none."""
    self.coasted += acceleration * period
    self.since += period

  def supported(self, speed: float, reach: float) -> bool:
    """Whether the accelerometer has felt what the encoder says: a car that hits something is no fault of it.

    The filter's gate, m/s, opens while it refuses; what counts is the gate at the first refusal.
    """
    return abs(speed - self.coasted) <= (self.reach if self.refusals else reach) + COASTING * self.since

  def judge(self, speed: float, innovation: float, reach: float, fits: bool) -> None:
    """Take the filter's verdict on a sample, m/s: its innovation and the reach of its gate, m/s."""
    if self.suspended:
      self.agreements = self.agreements + 1 if abs(innovation) <= self.reach else 0
      self.suspended = self.agreements < AGREEMENTS
      self.refusals = 0
    elif fits:
      self.refusals, self.coasted, self.since = 0, speed, 0.0
    else:
      self.reach = self.reach if self.refusals else reach
      self.refusals += 1
      self.suspended, self.agreements = self.refusals >= REFUSALS, 0

  def restart(self) -> None:
    """Forget the fixes: stamps are by another clock from now on."""
    self.fixes = ()

  def excuse(self, speed: float) -> None:
    """A sliding car's wheels tell nothing of its speed, m/s, nor its speed of them: comparisons begin anew."""
    self.refusals, self.contrary, self.fixes = 0, 0, ()
    self.coasted, self.since = speed, 0.0

  def travel(self, speed: float, period: float) -> None:
    """Add one encoder sample, m/s held for `period` s."""
    self.distance += abs(speed) * period

  def compare(self, time: float, x: float, y: float, std: float, turned: float = 0.0) -> None:
    """Take a raw fix with its standard deviation, m, and settle whether the encoder is believed.

    Args:
      turned: integral of the gyro, rad.
    """
    if self.fixes and time - self.fixes[-1][0] < SPACING:
      return
    self.fixes = (*self.fixes[-WINDOW:], (time, x, y, self.distance, turned))
    if len(self.fixes) <= WINDOW:
      return
    steps = [_step(a, b) for a, b in itertools.pairwise(self.fixes)]
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


def _step(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float, float]:
  """From one fix to the next: s, m and m along axes that turn with the car, encoder's m along the chord."""
  dx, dy, turn, middle = b[1] - a[1], b[2] - a[2], b[4] - a[4], 0.5 * (a[4] + b[4])
  cos, sin = math.cos(middle), math.sin(middle)
  chord = math.sin(0.5 * turn) / (0.5 * turn) if turn else 1.0
  return b[0] - a[0], cos * dx + sin * dy, cos * dy - sin * dx, chord * (b[3] - a[3])


@dataclasses.dataclass(slots=True)
class StampWatch:
  """Whether the fixes' stamps keep the lidar's beat.

  A lidar turns at its own rate whatever becomes of its data on their way. Stamps that are made from the time of
  arrival keep that rate, too, until the latency changes: then they miss the beat, all by the same time. A fix off the
  beat is not used until three agree by how much, which is then the latency that the stamps do not say. Nothing arrives
  before it was measured, so that it is an added latency of up to four fifths of an interval. Stamps without a beat are
  taken as they are.

  A clock that all sensors share and that is set forward moves the beat, too, and leaves a hole in all of them that is
  at least as long. Where there is such a hole, the stamps are believed and the beat is learnt anew.

  Attributes:
    stamps: s, the last ones on the beat.  holes: s, the longest that nothing at all was heard before each of them.
    delay: of the fixes beyond their stamps, s.
    odd: s, the last ones that missed it.
    slack: s, by which a stamp may miss it.
  """

  stamps: tuple[float, ...] = ()
  holes: tuple[float, ...] = ()
  delay: float = 0.0
  odd: tuple[float, ...] = ()
  slack: float = 0.0

  def copy(self) -> "StampWatch":
    """An independent copy."""
    return copy.copy(self)

  def restart(self) -> None:
    """Forget the beat: stamps are by another clock from now on."""
    self.stamps = self.odd = self.holes = ()

  def hear(self, stamp: float, hole: float = 0.0) -> bool:
    """Take a stamp, s, and for how long at most nothing at all was heard since the last one, s; whether its fix may be
    used."""
    if len(self.stamps) <= BEATS:
      self.stamps, self.holes = (*self.stamps, stamp), (*self.holes, hole)
      return True
    gaps = [b - a for a, b in itertools.pairwise(self.stamps)]
    interval = statistics.median(gaps)
    beats = lambda time: time / interval - round(time / interval)
    if interval <= 0.0 or max(abs(beats(gap)) for gap in gaps) > OFF_BEAT:
      return self._on(stamp, hole)
    if abs(beats(stamp - self.stamps[-1])) <= OFF_BEAT:
      return self._on(stamp, hole)
    later = (stamp - self.stamps[-1]) % interval
    if hole - max(self.holes) >= later - OFF_BEAT * interval:
      self.stamps, self.holes, self.odd = (stamp,), (max(self.holes),), ()
      return True
    self.odd = (*self.odd[1 - PERSISTENCE :], stamp)
    if len(self.odd) < PERSISTENCE or max(abs(beats(b - a)) for a, b in itertools.pairwise(self.odd)) > OFF_BEAT:
      return False
    change = interval * beats(stamp - self.stamps[-1])
    self.slack = OFF_BEAT * interval
    # an added latency of less than an interval
    self.delay = (self.delay + change + self.slack) % interval - self.slack
    self.stamps = tuple(s + change for s in self.stamps)
    return self._on(stamp, hole)

  def _on(self, stamp: float, hole: float) -> bool:
    self.stamps, self.holes, self.odd = (*self.stamps[1:], stamp), (*self.holes[1:], hole), ()
    return True
