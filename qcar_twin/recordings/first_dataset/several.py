"""Several columns that may be one channel: two gyros, four wheels, two poses. One is chosen and why, or it is asked.

With the numbers below the right one of the sensors of `python -m tests.faults.thresholds` is taken, or it is asked; the
same command measures how far each could be moved.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.units import compare
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, hold, possible, scale, stepped
from qcar_twin.recordings.first_dataset.heading import unwrap_heading
from qcar_twin.recordings.first_dataset.mount import on_three_axes
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.formats.axles import MEAN
from qcar_twin.recordings.unit_names import words_of

Array = NDArray[np.float64]

_ALTERNATIVE = 0.55  # of a name's score, within which another name says as much
_CLEAR = 0.3  # of it, from which the name decides where nothing else does
_APART = 0.05  # of a correlation with a witness, from which one column is the better sensor
_ALIKE = 0.98  # correlation of columns that measure one thing, and differ by noise
_MEAN = 0.25  # s, within which a car's motion changes little, and over which noise is averaged away
_SPIKE, _SPIKES = 8.0, 5e-4  # times the usual step, and share of the samples, of a sensor that spikes
_POSE = ("pose_x", "pose_y", "pose_yaw")
_AXES = {"x", "y", "z", "px", "py", "yaw", "heading", "theta", "psi", "phi", "pose", "pos", "position", "orientation"}
_MOST = 200000  # samples of a pose that are looked at
_LEAST = 10  # bins that a correlation is worth


@dataclasses.dataclass(frozen=True)
class Question:
  """A channel that columns of this log may equally be, and why none was chosen."""

  channel: str
  columns: tuple[str, ...]
  why: str

  @property
  def text(self) -> str:
    """For a person who has to answer it."""
    return f"{self.channel} is {' or '.join(repr(name) for name in self.columns)}: {self.why}"


def settle_several(
  columns: Columns, guesses: dict[str, Guess], vehicle: Mapping[str, float | str]
) -> tuple[Question, ...]:
  """Choose among the columns that may be one channel; questions where nothing tells them apart.

  A pose is taken from one source whole. Else the sensor that the other channels agree with is taken; of sensors that
  agree alike, or differ by noise alone, the one without spikes that is on three axes, else nearest to the rest; of two
  that differ and that nothing witnesses, the one with the clearly better name, and none where the names say as much.
  """
  _one_source(columns, guesses)
  unwrap_heading(columns, guesses)  # the logs are read for witnesses, and one with turns of 360 rad is not
  questions = []
  for channel, guess in list(guesses.items()):
    alternatives = _alternatives(columns, guesses, channel)
    if alternatives:
      question = _choose(columns, guesses, guess, alternatives, vehicle)
      questions += [question] if question else []
  _one_commander(columns, guesses)
  return tuple(questions)


def _score(name: str, channel: str) -> float:
  return next((reading.score for reading in readings(name) if reading.channel == channel), -math.inf)


def _alternatives(columns: Columns, guesses: Mapping[str, Guess], channel: str) -> list[str]:
  """Columns, not taken, whose names say a channel as well as the one that was chosen."""
  if channel == "time" or channel in _POSE:
    return []
  taken = {guess.column for guess in guesses.values()} | {guess.gate for guess in guesses.values()}
  chosen = guesses[channel].column
  best, least = _score(chosen, channel), stepped(columns, chosen, channel)
  return [
    name
    for name in columns.names
    if name not in taken
    and math.isfinite(score := _score(name, channel))
    and score >= best - _ALTERNATIVE
    and possible(columns, name, channel)
    and stepped(columns, name, channel) <= least
  ]


def runner_up(columns: Columns, guess: Guess) -> str:
  """What a name scored for its channel and the best of the others, for the line of a draft."""
  own = _score(guess.column, guess.channel)
  others = [(_score(name, guess.channel), name) for name in columns.names if name != guess.column]
  score, name = max(others, default=(-math.inf, ""))
  if not math.isfinite(own):
    return ""
  return f"name {own:.2f}, next '{name}' {score:.2f}" if math.isfinite(score) else f"name {own:.2f}, no other"


def _choose(
  columns: Columns,
  guesses: dict[str, Guess],
  guess: Guess,
  alternatives: Sequence[str],
  vehicle: Mapping[str, float | str],
) -> Question | None:
  names = (guess.column, *alternatives)
  heard = {name: _witnessed(columns, guesses, guess, name, vehicle) for name in names}
  known = {name: value for name, value in heard.items() if math.isfinite(value)}
  best = max(known, key=lambda name: known[name], default="")
  near = [name for name in names if name in known and known[best] - known[name] < _APART]
  if known and len(near) < len(names):
    others = ", ".join(f"'{n}' {heard[n]:.3f}" if n in known else f"'{n}' not at all" for n in names if n != best)
    _take(columns, guesses, guess, near[0] if guess.column not in near else guess.column)
    guess.why.append(f"other sensors agree with it ({heard[guess.column]:.3f}; {others})")
    names = tuple(near)
  if len(names) < 2:
    return None
  likeness = _likeness(columns, names)
  by_means = _likeness(columns, names, guesses.get("time"))
  noise = not known and min(likeness.values()) <= _ALIKE < min(by_means.values())
  if known or noise or min(likeness.values()) > _ALIKE:
    spikes = {name: _spikes(columns.values(name)) for name in names}
    clean = [name for name in names if spikes[name] <= max(min(spikes.values()), _SPIKES)]
    own = on_three_axes(columns) if CHANNELS[guess.channel].device == "imu" else set()
    whole = lambda name: name.startswith(MEAN)  # of an axle, whose wheels are faster and slower in turns
    chosen = max(clean, key=lambda name: (name in own, whole(name), round(likeness[name], 3), name == guess.column))
    said = ["they differ by noise alone"] if noise else []
    said += ["of three axes, the sensor's own"] if {chosen} == own & {*names} else []
    said += [f"'{name}' spikes in {1e2 * spikes[name]:.2g} % of its samples" for name in names if name not in clean]
    _take(columns, guesses, guess, chosen)
    guess.why.append("; ".join([f"of {len(names)} alike ({', '.join(names)}) the nearest to all", *said]))
    return None
  if len(names) > 2 and sum(value > _ALIKE for value in likeness.values()) >= 2:
    chosen = max(names, key=lambda name: likeness[name])
    _take(columns, guesses, guess, chosen)
    odd = ", ".join(name for name in names if likeness[name] <= _ALIKE)
    guess.why.append(f"most of {len(names)} that may be it agree; unlike them: {odd}")
    return None
  margin = _score(guess.column, guess.channel) - max(_score(name, guess.channel) for name in names[1:])
  if margin >= _CLEAR:
    guess.why.append(f"its name says so by {margin:.2f} more than '{names[1]}', which differs")
    return None
  apart = min(likeness.values())
  return Question(guess.channel, names, f"they differ (correlation {apart:.2f}), and no other channel tells which")


def _one_commander(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Both commands from one topic, where two have both: a controller's wish, say, and what the car was given. How the
  car turned has told whose steering it obeyed."""
  source = lambda name: name.rpartition(".")[0]
  drive = next((channel for channel in DRIVE_COMMANDS if channel in guesses), None)
  if drive is None or "steering_command" not in guesses:
    return
  guess, obeyed = guesses[drive], source(guesses["steering_command"].column)
  other = source(guess.column)
  if not obeyed or not other or obeyed == other:
    return
  of_other = [n for n in columns.names if source(n) == other and _score(n, "steering_command") > 0.0]
  scores = {n: score for n in columns.names if source(n) == obeyed and (score := _score(n, drive)) > 0.0}
  scores = {n: score for n, score in scores.items() if not columns.constant(n)}
  if of_other and scores and len(columns.holding(best := max(scores, key=lambda n: scores[n]))) == len(columns.tables):
    _take(columns, guesses, guess, best)
    guess.why.append(f"beside the steering that the car obeyed, '{guesses['steering_command'].column}'")


def _take(columns: Columns, guesses: Mapping[str, Guess], guess: Guess, name: str) -> None:
  """Another column for a guess, read as it is: its own factor, and its own rate."""
  if guess.column != name:
    guess.column, guess.wrap, guess.hold, guess.why = name, None, False, []
    scale(columns, guess)
    hold(columns, {channel: guesses[channel] for channel in ("time", guess.channel) if channel in guesses})


def _witnessed(
  columns: Columns, guesses: dict[str, Guess], guess: Guess, name: str, vehicle: Mapping[str, float | str]
) -> float:
  """Mean size of the correlation with what other sensors say of it, or where none does, a command; NaN where nothing
  does. Odometry's turning is often the commanded one, which a command witnesses better than any gyro."""
  trial = {**guesses, guess.channel: dataclasses.replace(guess, column=name)}
  made = [
    comparison
    for recording in recordings_of(columns, trial)
    for comparison in compare(recording, vehicle)
    if guess.channel in comparison.takes
  ]
  sensed = [comparison for comparison in made if not any(CHANNELS[name].is_command for name in comparison.takes)]
  heard = [abs(comparison.slope()[1]) for comparison in sensed or made]
  heard = [value if math.isfinite(value) else 0.0 for value in heard]
  return float(np.mean(heard)) if heard else math.nan


def _likeness(columns: Columns, names: Sequence[str], clock: Guess | None = None) -> dict[str, float]:
  """Correlation of each column with the median of all, each in units of its own spread; 0 where no log has all. Between
  its samples a column goes on in a line: sensors of rates of their own share few rows.

  Args:
    clock: where given, means over a quarter of a second are compared: white noise is averaged away, and two motions
      that differ go on to do so.
  """
  tables = [table for table in columns.tables if all(name in table for name in names)]
  if not tables:
    return dict.fromkeys(names, 0.0)
  rows = lambda table, name: _in_a_line(table.number(name, name)) if clock is None else _means(table, name, clock)
  values = np.stack([np.concatenate([rows(t, name) for t in tables]) for name in names])
  values = values[:, np.isfinite(values).any(axis=0)]
  low, middle, high = np.nanpercentile(values, [10, 50, 90], axis=1, keepdims=True)
  scaled = (values - middle) / np.where(high > low, high - low, 1.0)
  centre = np.nanmedian(scaled, axis=0) if len(names) > 2 else scaled[0]
  return {name: correlation(row, centre, _LEAST) for name, row in zip(names, scaled, strict=True)}


def _means(table: Table, name: str, clock: Guess) -> Array:
  """Of a column's samples in each piece of `_MEAN` s of the clock; NaN where there is none."""
  time, values = clock.scale * table.number(clock.column, "time"), table.number(name, name)
  time = np.cumsum(time) if clock.steps else time
  pieces, which = np.unique(np.floor((time - time[0]) / _MEAN), return_inverse=True)
  there = np.isfinite(values)
  count = np.bincount(which[there], minlength=pieces.size)
  total = np.bincount(which[there], values[there], pieces.size)
  return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _in_a_line(values: Array) -> Array:
  """Values with what lies between two of them; NaN before the first and after the last."""
  there = np.flatnonzero(np.isfinite(values))
  if not len(there):
    return values
  return np.interp(np.arange(len(values)), there, values[there], left=np.nan, right=np.nan)


def _spikes(values: Array) -> float:
  """Share of samples that stand out of their two neighbours by many usual steps."""
  if len(values) < _LEAST:
    return 0.0
  out = np.minimum(np.abs(values[1:-1] - values[:-2]), np.abs(values[1:-1] - values[2:]))
  same_side = (values[1:-1] - values[:-2]) * (values[1:-1] - values[2:]) > 0.0
  usual = float(np.percentile(np.abs(np.diff(values)), 90))
  return float(np.mean(same_side & (out > _SPIKE * usual))) if usual > 0.0 else 0.0


def _one_source(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Take x, y and heading from one source, where several were logged: the one with all three, then the fewest jumps."""
  if not {"pose_x", "pose_y"} <= guesses.keys():
    return
  sources: dict[tuple[str, ...], dict[str, str]] = {}
  for name in columns.names:
    for channel in _POSE:
      if _score(name, channel) > 0.0 and not columns.constant(name):
        stem = tuple(word for word in words_of(name) if word not in _AXES)
        sources.setdefault(stem, {}).setdefault(channel, name)
  whole = {stem: names for stem, names in sources.items() if {"pose_x", "pose_y"} <= names.keys()}
  taken = {channel: guesses[channel].column for channel in _POSE if channel in guesses}
  if len(whole) < 2:
    for names in whole.values():  # the place's own heading, not one of odometry that has no place
      _own_heading(columns, guesses, names)
    return
  jumps = {stem: _jumps(columns, names) for stem, names in whole.items()}
  own = lambda names: sum(names.get(channel) == column for channel, column in taken.items())
  best = min(whole, key=lambda stem: (-len(whole[stem]), round(jumps[stem], 4), -own(whole[stem])))
  for channel, name in whole[best].items():
    if channel in guesses:
      _take(columns, guesses, guesses[channel], name)
    else:
      guesses[channel] = Guess(channel, name, why=["its name says so"])
    others = ", ".join(f"'{names[channel]}'" for stem, names in whole.items() if stem != best and channel in names)
    said = f"{1e2 * jumps[best]:.2g} % of its steps are jumps, {1e2 * max(jumps.values()):.2g} % of another's"
    guesses[channel].why.append(f"one of {len(whole)} poses, all from one source (not {others}): {said}")


def _own_heading(columns: Columns, guesses: dict[str, Guess], names: Mapping[str, str]) -> None:
  """Of several headings the one of the only source that has a place, too."""
  guess, own = guesses.get("pose_yaw"), names.get("pose_yaw")
  if guess is None or own is None or guess.column == own:
    return
  other = guess.column
  _take(columns, guesses, guess, own)
  guess.why.append(f"from one source with '{names['pose_x']}' (not '{other}')")


def _jumps(columns: Columns, names: Mapping[str, str]) -> float:
  """Share of the steps of a place that are many times the usual one."""
  x, y = (columns.values(names[c])[:_MOST] for c in ("pose_x", "pose_y"))
  count = min(len(x), len(y))
  steps = np.hypot(np.diff(x[:count]), np.diff(y[:count]))
  moving = steps[steps > 0.0]
  return float(np.mean(moving > _SPIKE * np.percentile(moving, 90))) if moving.size else 1.0
