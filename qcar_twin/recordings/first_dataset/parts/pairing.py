"""Which files of a command and of a motion belong together: by their names, by their clocks, by the motion itself."""

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np

from qcar_twin.recordings.first_dataset.by_unit import guess_by_unit
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, guess_columns
from qcar_twin.recordings.first_dataset.heading import unwrap_heading
from qcar_twin.recordings.first_dataset.parts.drift import Clock, Pair, drifts
from qcar_twin.recordings.first_dataset.parts.motion import Fit, Motion, fit, motion_of
from qcar_twin.recordings.first_dataset.parts.torn import COMMANDS, MOTION, is_clock
from qcar_twin.recordings.first_dataset.plane import settle_plane
from qcar_twin.recordings.formats.table import Clocked, Table
from qcar_twin.recordings.recording import RecordingError

_ALIKE = 0.8  # correlation of two sensors of one motion, as the check has it
_CLEAR = 0.1  # of a correlation, by which one of two files, or of two lags, goes better with a third
_LATE = 0.5  # s, from which a lag is none of a sensor or a servo
_SHARED = 0.5  # of the shorter file's time that two files of one drive share
_SHARE = "their clocks"
_CURE = "give the files of one drive names that differ by one word alone, run1_car.csv and run1_mocap.csv say"


@dataclasses.dataclass(frozen=True)
class Part:
  """One file: its columns, what they are guessed to be, and whether commands and motion are among them."""

  label: str
  columns: Columns
  guesses: Mapping[str, Guess]
  commands: bool
  motion: bool

  @property
  def whole(self) -> bool:
    return self.commands and self.motion

  @property
  def stem(self) -> str:
    return "_".join(PurePosixPath(self.label).with_suffix("").parts)

  @property
  def words(self) -> tuple[str, ...]:
    """Words and numbers of its name and its folders'."""
    return words_of_file(self.stem)

  @functools.cached_property
  def moved(self) -> Motion:
    return motion_of(self.columns, self.guesses)

  @functools.cached_property
  def like(self) -> frozenset[str]:
    """The names of its columns: files with the same were logged alike."""
    return frozenset(self.columns.names)


def part_of(table: Table, columns: Columns | None = None) -> Part:
  """A file as a part of a drive; `columns`: its own, where they are known."""
  columns = Columns((table,)) if columns is None else columns
  guesses = guess_columns(columns)
  guess_by_unit(columns, guesses)
  settle_plane(columns, guesses)
  unwrap_heading(columns, guesses)
  known = lambda channels: not guesses.keys().isdisjoint(channels)
  return Part(table.label, columns, guesses, known(COMMANDS), known(MOTION))


def clocked(columns: Columns, clock: Guess, prefix: str) -> Clocked:
  """A file's columns on its clock in s; its name before each, since a topic's columns are often called `data`."""
  known = columns.tables[0]
  time = clock.scale * known.number(clock.column, "time")
  names = [n for n in columns.names if n != clock.column and not is_clock(n)]
  return Clocked(
    np.cumsum(time) - time[0] if clock.steps else time, {f"{prefix}.{name}": known.number(name, name) for name in names}
  )


def words_of_file(name: str) -> tuple[str, ...]:
  """Words and numbers of a file's name, `1` of `run_01`."""
  return tuple(str(int(word)) if word.isdecimal() else word for word in re.findall(r"[a-z]+|\d+", name.lower()))


Group = tuple[tuple[Part, Clock], ...]  # files of one drive, and how each one's clock becomes the drive's


@dataclasses.dataclass(frozen=True)
class Drives:
  """Which files belong together, what stands before the columns of each, and how that came about."""

  groups: tuple[Group, ...]
  prefixes: Mapping[str, str]
  said: tuple[str, ...]


def paired(parts: Sequence[Part]) -> Drives | None:
  """Files of two kinds, of which one has the commands and the other motion that is in no file of the first; None where
  files aren't of two such kinds.

  Names propose who belongs together, else clocks, else the motion. The motion, where both saw it, has to agree, and
  says how the clocks lie.

  Raises:
    RecordingError: they are of two such kinds, and who belongs together cannot be told.
  """
  kinds: dict[frozenset[str], list[Part]] = {}
  for part in parts:
    if "time" not in part.guesses:
      return None
    kinds.setdefault(part.like, []).append(part)
  if len(kinds) != 2:
    return None
  cars, others = sorted(kinds.values(), key=lambda kind: (-kind[0].commands, -kind[0].motion))
  fills = {"pose_x", "yaw_rate", "speed", "motor_speed"} & others[0].guesses.keys() - cars[0].guesses.keys()
  if not cars[0].commands or others[0].commands or not fills:
    return None
  prefixes = {part.label: _prefix(kind) for kind in (cars, others) for part in kind}
  if len(set(prefixes.values())) < 2:
    prefixes |= {part.label: f"{prefixes[part.label]}_2" for part in others}
  partners = _partners(cars, others)
  groups, said, moved = [], [], []
  for car in cars:
    other, why, turned = partners.get(car.label, (None, "", 0))
    if other is None:
      alone = "is read alone" if car.whole else "left out"
      said.append(f"{car.label}: {alone}, no other file is of its drive")
      groups += [((car, Clock()),)] if car.whole else []
      continue
    shift, how = shift_of(car, other, turned)
    said.append(f"{car.label}, {other.label}: parts of one drive {why}, joined by {how}")
    moved += [(len(groups), Pair(car.moved, other.moved, shift, turned))] if how != _SHARE else []
    groups.append(((car, Clock()), (other, Clock(shift))))
  fast, clocks = drifts([pair for _, pair in moved])
  for (at, _), clock in zip(moved, clocks, strict=True) if fast else ():
    groups[at] = ((groups[at][0][0], clock), *groups[at][1:])
  if fast:
    way, other = "fast" if fast > 0.0 else "slow", next(iter(partners.values()))[0]
    said.append(
      f"the clock of {cars[0].label} runs {100.0 * abs(fast):.2f} % {way} against that of {other.label}, by the motion"
      " in pieces of the drives: its times, and those of all logs like it, are divided by that"
    )
  taken = {other.label for other, _, _ in partners.values()}
  said += [f"{o.label}: left out, no file of commands is of its drive" for o in others if o.label not in taken]
  return Drives(tuple(groups), prefixes, tuple(said)) if partners else None


def _prefix(kind: Sequence[Part]) -> str:
  """The words that all files of a kind share; one file's own name, where it is the only one."""
  if len(kind) == 1:
    return PurePosixPath(kind[0].label).stem
  shared = [word for word in kind[0].words if all(word in part.words for part in kind) and not word.isdigit()]
  return "_".join(shared) or "log"


def _keys(kind: Sequence[Part], other: Sequence[Part]) -> dict[str, tuple[str, ...]]:
  """By file the words of its name, without those that all files of its kind have: a date's, say, tell none of them. Of
  a lone file those stay that the other kind has."""
  everywhere = {word for word in kind[0].words if all(word in part.words for part in kind)}
  anywhere = {word for part in other for word in part.words}
  own = everywhere if len(kind) > 1 else everywhere - anywhere
  return {part.label: tuple(word for word in part.words if word not in own) for part in kind}


def _partners(cars: Sequence[Part], others: Sequence[Part]) -> dict[str, tuple[Part, str, int]]:
  """By file of commands the one of the other kind, why, and which way the two count turning, as `fit` takes it."""
  if len(cars) == len(others) == 1:
    return {cars[0].label: (others[0], "by their columns", 0)}
  keys, of_others = _keys(cars, others), _keys(others, cars)
  named = {
    car.label: same
    for car in cars
    if len(same := [o for o in others if sorted(of_others[o.label]) == sorted(keys[car.label])]) == 1
  }
  once = [same[0].label for same in named.values()]
  if named and len(set(once)) == len(once):
    by_label = {car.label: car for car in cars}
    for label, (other,) in named.items():
      _confirm(by_label[label], other, cars)
    return {label: (other, "by their names", 0) for label, (other,) in named.items()}
  shared = lambda car, other: min(car.moved.end, other.moved.end) - max(car.moved.start, other.moved.start)
  least = lambda car, other: _SHARED * min(p.moved.end - p.moved.start for p in (car, other))
  by_clock, unclear = _mutual(cars, others, lambda car, other: float(shared(car, other) > least(car, other)), 0.5)
  if by_clock and not unclear:
    return {label: (other, "by their clocks", 0) for label, other in by_clock.items()}
  by_motion, turned = _by_motion(cars, others)
  if by_motion:
    return {label: (other, "by their motion", turned) for label, other in by_motion.items()}
  raise RecordingError(
    f"{cars[0].label}, {others[0].label} and {len(cars) + len(others) - 2} more: commands and motion lie in files of"
    f" their own, and neither names nor clocks nor motion tell which belong together; {_CURE}"
  )


def _by_motion(cars: Sequence[Part], others: Sequence[Part]) -> tuple[dict[str, Part], int]:
  """Partners by their motion, and which way the two kinds count turning, as `fit` takes it; none where it isn't clear.

  Of a circle to the left and the same one to the right only that tells which is which. Two programs count all drives
  one way, so that the pairs that are clear without it say it of the others.
  """
  alike = lambda car, other, way: -1.0 if math.isnan(r := fit(car.moved, other.moved, way).alike) else r
  chosen, unclear = _mutual(cars, others, lambda car, other: alike(car, other, 0), _ALIKE)
  ways = set()
  for car in cars:
    if car.label in chosen:
      against, along = (alike(car, chosen[car.label], way) for way in (-1, 1))
      ways |= (
        {1 if along > against else -1} if max(along, against) > _ALIKE and abs(along - against) > _CLEAR else set()
      )
  if len(ways) > 1:
    return {}, 0
  turned = next(iter(ways), 0)
  if unclear and turned:
    chosen, unclear = _mutual(cars, others, lambda car, other: alike(car, other, turned), _ALIKE)
  return ({}, 0) if unclear else (chosen, turned)


def _mutual(
  cars: Sequence[Part], others: Sequence[Part], score: Callable[[Part, Part], float], least: float
) -> tuple[dict[str, Part], bool]:
  """Partners that have each other and nobody else, and whether there is a file that has two that fit about as well."""
  table = {(car.label, other.label): score(car, other) for car in cars for other in others}
  chosen: dict[str, Part] = {}
  unclear = False
  for car in cars:
    ranked = sorted(others, key=lambda other: -table[car.label, other.label])
    best = table[car.label, ranked[0].label]
    further = [table[car.label, other.label] for other in ranked[1:]]
    further += [table[rival.label, ranked[0].label] for rival in cars if rival is not car]
    if best <= least:
      continue
    if any(best - other < _CLEAR for other in further):
      unclear = True
      continue
    chosen[car.label] = ranked[0]
  return chosen, unclear


def _confirm(car: Part, other: Part, cars: Sequence[Part]) -> None:
  """Refuses a pair by names whose motion is clearly another file's."""
  own = fit(car.moved, other.moved)
  if math.isnan(own.alike) or own.alike > _ALIKE:
    return
  fits = {rival.label: fit(rival.moved, other.moved).alike for rival in cars if rival is not car}
  fits = {label: alike for label, alike in fits.items() if not math.isnan(alike)}
  best = max(fits, key=lambda label: fits[label], default="")
  if best and fits[best] > max(_ALIKE, own.alike + _CLEAR):
    raise RecordingError(
      f"{other.label}: goes with {car.label} by its name, and by its motion with {best} (correlation {fits[best]:.2f}"
      f" against {own.alike:.2f}); rename it after the drive that it is of, or leave one of the two out"
    )


def shift_of(car: Part, other: Part, turned: int = 0) -> tuple[float, str]:
  """Seconds to be added to the other's clock, and how that came about; `turned`: as `fit` takes it.

  Raises:
    RecordingError: the clocks differ, and the motion doesn't say by how much.
  """
  own: Fit = fit(car.moved, other.moved, turned)
  pair = f"{car.label}, {other.label}"
  together = min(car.moved.end, other.moved.end) - max(car.moved.start, other.moved.start)
  shared = together > _SHARED * min(p.moved.end - p.moved.start for p in (car, other))
  judged = own.alike > _ALIKE and not own.again > own.alike - _CLEAR
  as_good = own.as_stamped > own.alike - _CLEAR or abs(own.lag) < _LATE
  if shared and (not judged or as_good):
    return 0.0, _SHARE
  if judged:
    obeyed = ", and has in it what the car takes to obey: no two sensors saw one motion" if own.commanded else ""
    return own.lag, f"their motion (correlation {own.alike:.2f}), which moves {other.label} by {own.lag:.2f} s{obeyed}"
  why = "never moves alike" if not own.alike > _ALIKE else "repeats itself, so that several seconds fit as well"
  raise RecordingError(
    f"{pair}: are of one drive, their clocks have no time in common, and the motion {why}; add the seconds between the"
    f" two to the clock of {other.label}, or leave it out"
  )
