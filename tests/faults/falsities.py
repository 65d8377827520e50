"""False logs: every mistake of unit, sign, axis, age, clock and channel, through the loader and the log's check.

A drive that obeys geometry is written with one falsity. What comes out is counted: right (read as it was driven),
refused (an error, or a finding that spoils a fit), warned (a finding that names the channel), or passed wrongly, of
which there must be none.

python -m tests.faults.falsities --count 400 --seed 1
"""

import argparse
import collections
import dataclasses
import tempfile
from collections.abc import Callable, Container, Sequence
from pathlib import Path

import numpy as np

from calibration.log_check.check import check_log, load_to_check
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.first_dataset import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import Recording, RecordingError
from tests.faults.wander import RATE, SIZES, Array, Columns, wander
from tests.qcar_twin.recordings.drives import NOISE, VEHICLE, write_csv, write_manifest

DEG = 180.0 / np.pi
NAMES = {
  "motor_voltage": "motor_volts", "steering_command": "steer", "speed": "velocity", "accel_x": "acc_x",
  "accel_y": "acc_y", "yaw_rate": "gyro_z", "pose_x": "mocap_x", "pose_y": "mocap_y", "pose_yaw": "heading",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Falsity:
  """A mistake: the channels it is about, how it changes time and columns, and the channels it needs besides."""

  name: str
  channels: tuple[str, ...]
  apply: Callable[[Array, Columns], tuple[Array, Columns]]
  only: tuple[str, ...] = ()
  needs: tuple[str, ...] = ()

  def applies(self, channels: Container[str]) -> bool:
    """Whether a log of these channels can have it."""
    return all(name in channels for name in (*self.channels, *self.only, *self.needs) if name != "time")


def _value(name: str, channel: str, change: Callable[[Array], Array]) -> Falsity:
  return Falsity(name, (channel,), lambda t, c: (t, c | {channel: change(c[channel])}))


def _scaled(channel: str, unit: str, factor: float) -> Falsity:
  return _value(f"{channel} in {unit}", channel, lambda v: factor * v)


def _late(channel: str, seconds: float) -> Falsity:
  def apply(time: Array, columns: Columns) -> tuple[Array, Columns]:
    late, had = columns[channel].copy(), np.flatnonzero(np.isfinite(columns[channel]))
    before = np.searchsorted(time[had], time[had] - seconds + 1e-6, side="right") - 1
    late[had] = columns[channel][had[np.maximum(before, 0)]]
    return time, columns | {channel: late}

  return Falsity(f"{channel} {seconds:g} s late", (channel,), apply)


def _exchanged(one: str, other: str) -> Falsity:
  return Falsity(f"{one} and {other} exchanged", (one, other), lambda t, c: (t, c | {one: c[other], other: c[one]}))


def _wrapped(period: float, factor: float) -> Callable[[Array], Array]:
  return lambda v: factor * (np.mod(v + 0.5 * period, period) - 0.5 * period)


def _released(time: Array, columns: Columns) -> tuple[Array, Columns]:
  """A driver who asks for speed, for 30 s, from a car that was switched off while it stood."""
  step = float(np.ptp(time)) / (time.size - 1)
  at, count = int(np.searchsorted(time, time[0] + min(46.0, 0.5 * float(np.ptp(time))))), int(30.0 / step)
  moves = lambda name: name in CHANNELS and not name.startswith("pose")
  still = lambda name, v: np.full(count, 0.0 if moves(name) else v[at])
  noise = lambda name: 0.005 * np.random.default_rng(4).standard_normal(count) * (name in NOISE)
  spliced = {name: np.r_[v[:at], still(name, v) + noise(name), v[at:]] for name, v in columns.items()}
  spliced["motor_voltage"][at : at + count] = np.nanpercentile(columns["motor_voltage"], 70.0)
  return np.r_[time[:at], time[at] + step * np.arange(count), time[at:] + 30.0], spliced


def _staircase(values: Array) -> Array:
  """What was commanded, in steps of a second and more, in the measured speed's place."""
  random, levels = np.random.default_rng(9), np.zeros(values.size)
  edges = np.r_[0, np.cumsum(random.integers(int(RATE), int(4 * RATE), values.size // int(RATE)))]
  for first, last in zip(edges[:-1], edges[1:], strict=True):
    if first < values.size:
      levels[first:last] = values[min(last, values.size - 1)]
  return levels


def _turned_by(name: str, angle: float) -> Falsity:
  """A heading that is off, which is one only beside a place."""
  change = lambda t, c: (t, c | {"pose_yaw": c["pose_yaw"] + angle})
  return Falsity(name, ("pose_yaw",), change, needs=("pose_x",))


def _in_the_place(time: Array, columns: Columns) -> tuple[Array, Columns]:
  """Accelerations as a motion capture has them."""
  there = np.isfinite(columns["pose_yaw"])
  yaw = np.interp(time, time[there], np.unwrap(columns["pose_yaw"][there]))
  along, across = columns["accel_x"], columns["accel_y"]
  turned = {
    "accel_x": np.cos(yaw) * along - np.sin(yaw) * across,
    "accel_y": np.sin(yaw) * along + np.cos(yaw) * across,
  }
  return time, columns | turned


def _clock(name: str, change: Callable[[Array], Array]) -> Falsity:
  return Falsity(name, ("time",), lambda t, c: (change(t), c))


def _set_back(time: Array) -> Array:
  out = time.copy()
  out[len(out) // 2 :] -= 5.0
  return out


def _with_only(channels: tuple[str, ...], falsity: Falsity) -> Falsity:
  """The same mistake in a log of few channels, in which fewer witnesses tell."""
  kept = lambda name: name in channels or name not in CHANNELS  # a gate stays
  few = lambda t, c: falsity.apply(t, {name: v for name, v in c.items() if kept(name)})
  return Falsity(f"{falsity.name}, with commands and a pose alone", falsity.channels, few, only=channels)


_POSE_LOG = ("motor_voltage", "steering_command", "pose_x", "pose_y", "pose_yaw")
_IN_MM = Falsity(
  "pose in mm", ("pose_x", "pose_y"), lambda t, c: (t, c | {n: 1000.0 * c[n] for n in ("pose_x", "pose_y")})
)
_HALF, _TWICE = _clock("time at half speed", lambda t: 0.5 * t), _clock("time at twice the speed", lambda t: 2.0 * t)
EVERY = (
  *(_scaled("yaw_rate", unit, f) for unit, f in (("deg/s", DEG), ("turns per minute", 60.0 / (2.0 * np.pi)))),
  *(
    _scaled("speed", unit, f)
    for unit, f in (("km/h", 3.6), ("mph", 1.0 / 0.44704), ("cm/s", 100.0), ("knots", 3600.0 / 1852.0))
  ),
  _scaled("motor_speed", "turns per minute", 60.0 / (2.0 * np.pi)),
  _scaled("motor_speed", "turns per second", 1.0 / (2.0 * np.pi)),
  _scaled("motor_speed", "rad/s of the wheel", 0.1),
  _value("motor_speed with the other sign", "motor_speed", lambda v: -v),
  *(_late("motor_speed", s) for s in (0.7, 2.0, 6.0)),
  *(_scaled(channel, "g", 1.0 / 9.80665) for channel in ("accel_x", "accel_y")),
  _IN_MM,
  _scaled("steering_command", "degrees", DEG),
  _scaled("steering_command", "per cent of lock", 100.0 / 0.5236),
  _scaled("pose_yaw", "degrees", DEG),
  _value("pose_yaw in degrees, wrapped", "pose_yaw", _wrapped(2.0 * np.pi, DEG)),
  _value("pose_yaw wrapped", "pose_yaw", _wrapped(2.0 * np.pi, 1.0)),
  _value("pose_yaw wrapped at half a turn", "pose_yaw", _wrapped(np.pi, 1.0)),
  _value("pose_yaw from north, clockwise", "pose_yaw", lambda v: 0.5 * np.pi - v),
  *(
    _value(f"{c} with the other sign", c, lambda v: -v)
    for c in ("yaw_rate", "accel_x", "accel_y", "pose_yaw", "pose_y")
  ),
  _value("steering_command with the other sign", "steering_command", lambda v: -v),
  _turned_by("pose_yaw turned round", np.pi),
  _turned_by("pose_yaw a quarter turn off", 0.5 * np.pi),
  _exchanged("accel_x", "accel_y"),
  _exchanged("pose_x", "pose_y"),
  _exchanged("speed", "accel_x"),
  _value("accel_y that feels nothing", "accel_y", lambda v: 0.1 * np.random.default_rng(5).standard_normal(v.size)),
  _value("yaw_rate of another axis", "yaw_rate", lambda v: 0.05 * np.random.default_rng(6).standard_normal(v.size)),
  *(_late(channel, s) for channel in ("yaw_rate", "accel_x", "speed") for s in (0.7, 2.0, 6.0)),
  _value("motor_voltage about a neutral of 5 V", "motor_voltage", lambda v: v + 5.0),
  _value("steering_command about 0.6 rad", "steering_command", lambda v: v + 0.6),
  Falsity("a released switch under a driver who asks for speed", ("motor_voltage",), _released, needs=("speed",)),
  _value("the commanded speed as the measured one", "speed", _staircase),
  _value("speed that reads 30 % high", "speed", lambda v: 1.3 * v),
  _clock("time in ms", lambda t: 1000.0 * t),
  _clock("time a stamp of the day", lambda t: t + 1759663727.0),
  _clock("time set back by 5 s", _set_back),
  _clock("time as steps", lambda t: np.full(t.size, 1.0 / RATE)),
  _HALF,
  _TWICE,
  *(_with_only(_POSE_LOG, falsity) for falsity in (_HALF, _TWICE, _IN_MM)),
  Falsity(
    "accel_x and accel_y exchanged, one with the other sign",
    ("accel_x", "accel_y"),
    lambda t, c: (t, c | {"accel_x": c["accel_y"], "accel_y": -c["accel_x"]}),
  ),
  Falsity("accelerations along the axes of the place", ("accel_x", "accel_y"), _in_the_place, needs=("pose_yaw",)),
  _value(
    "accel_x of the vertical axis",
    "accel_x",
    lambda v: 9.80665 + 0.1 * np.random.default_rng(7).standard_normal(v.size),
  ),
)


FALSITIES = tuple(falsity for falsity in EVERY if falsity.applies(NAMES))  # of what drives by formula have


def outcome(falsity: Falsity | None, seed: int, size: float, folder: Path, drafted: bool = False) -> tuple[str, str]:
  """ "right", "refused", "warned" or "passed wrongly", and what was said.

  Args:
    drafted: the log has names of a stranger, and what `new` proposes for it is read; else the channels' own names.
  """
  time, columns = wander(seed, size)
  stamps, changed = falsity.apply(time, columns) if falsity else (time, columns)
  try:
    (_drafted if drafted else write_drive)(folder, stamps, changed, size)
    check = check_log(load_to_check(folder))
  except RecordingError as error:
    return "refused", str(error)
  if spoiling := check.of("spoils"):
    return "refused", spoiling[0].text
  if _same(check.dataset.recordings, time, columns, 0.06 if drafted else 1e-6):
    return "right", check.verdict
  named = falsity.channels if falsity else ()
  said = [f.text for f in check.of("beware") if any(channel in f.text for channel in named)]
  return ("warned", said[0]) if said else ("passed wrongly", check.verdict)


def write_drive(folder: Path, time: Array, columns: Columns, size: float) -> None:
  """A drive and its dataset.toml, under the channels' own names, of a car `size` times as long as a 1:10 one."""
  write_csv(folder / "run.csv", time, columns)
  powers = {"mass": 3, "yaw_inertia": 5, "gear_ratio": 0, "max_steering": 0}
  car = {key: value * size ** powers.get(key, 1) for key, value in VEHICLE.items() if not isinstance(value, str)}
  write_manifest(folder, vehicle=car)


def _drafted(folder: Path, time: Array, columns: Columns, size: float) -> None:
  write_csv(folder / "run.csv", time, {NAMES[channel]: values for channel, values in columns.items()})
  proposal = propose("lab", [read_table(folder / "run.csv", "run.csv")])
  (folder / "dataset.toml").write_text(proposal.text, encoding="utf-8")


def _same(recordings: Sequence[Recording], time: Array, columns: Columns, steering: float) -> bool:
  """Whether recordings are the drive, up to whole turns of the heading and where its clock begins.

  Args:
    steering: how far the steering may be off, as a share of its largest; a wheelbase that nobody said is guessed.
  """
  for name, values in columns.items():
    streams = [r[name] for r in recordings if name in r]
    if not streams:
      return False
    stamp = np.round(np.concatenate([s.time for s in streams])[::-1], 6)  # of two at a cut the sample, not its hold
    stamps, first = np.unique(stamp, return_index=True)
    read = np.concatenate([s.value for s in streams])[::-1][first]
    if len(stamps) != time.size or np.abs(stamps - stamps[0] - time).max() > 1e-5:
      return False
    apart = read - values
    apart = apart - 2.0 * np.pi * np.round(apart[0] / (2.0 * np.pi)) if name == "pose_yaw" else apart
    share = steering if name == "steering_command" else 1e-6
    if np.abs(apart).max() > share * max(1.0, float(np.abs(values).max())):
      return False
  return True


def table(
  count: int, seed: int, drafted: bool = False
) -> tuple[collections.Counter, dict[str, collections.Counter], list[str]]:
  """Counts of outcomes, by falsity, and what was said where one passed; every falsity in turn, sizes by chance."""
  random, total = np.random.default_rng(seed), collections.Counter()
  rows: dict[str, collections.Counter] = {}
  passed = []
  with tempfile.TemporaryDirectory() as folder:
    for number in range(count):
      falsity = FALSITIES[number % len(FALSITIES)]
      name, size = list(SIZES.items())[int(random.integers(len(SIZES)))]
      name, size = ("1:10", 1.0) if drafted else (name, size)
      result, said = outcome(falsity, int(random.integers(2**31)), size, Path(folder), drafted)
      total[result] += 1
      rows.setdefault(falsity.name, collections.Counter())[result] += 1
      if result == "passed wrongly":
        passed.append(f"{falsity.name}, {name}: {said}")
  return total, rows, passed


def alarms(count: int, seed: int) -> list[str]:
  """What is said against sound logs of every size: refusals and findings that spoil."""
  random = np.random.default_rng(seed)
  with tempfile.TemporaryDirectory() as folder:
    said = [
      outcome(None, int(random.integers(2**31)), list(SIZES.values())[k % len(SIZES)], Path(folder))
      for k in range(count)
    ]
  return [text for result, text in said if result != "right"]


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--count", type=int, default=400, help="False logs.")
  parser.add_argument("--sound", type=int, default=60, help="Sound logs.")
  parser.add_argument("--seed", type=int, default=1, help="Of the drives and sizes.")
  parser.add_argument(
    "--drafted", action="store_true", help="Under a stranger's names, as `new` proposes to read them."
  )
  config = parser.parse_args()
  total, rows, passed = table(config.count, config.seed, config.drafted)
  kinds = ("right", "refused", "warned", "passed wrongly")
  print("| falsity | " + " | ".join(kinds) + " |")
  print("|---" * 5 + "|")
  for name, counts in rows.items():
    print(f"| {name} | " + " | ".join(str(counts[kind]) for kind in kinds) + " |")
  print("| all | " + " | ".join(str(total[kind]) for kind in kinds) + " |")
  print("\n".join(passed))
  wrong = alarms(config.sound, config.seed)
  print(f"false alarms on {config.sound} sound logs: {len(wrong)}")
  print("\n".join(wrong))


if __name__ == "__main__":
  main()
