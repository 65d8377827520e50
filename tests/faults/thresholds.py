"""How the numbers that decide whether a command acted were chosen: what each does to sound and to false drives.

Every number is varied by itself. Sound drives that are then blamed and false ones that are then passed are counted; the
range without either is printed, and whether the number in use lies inside it.

python -m tests.faults.thresholds --drives 8 --seed 1
python -m tests.faults.thresholds --drives 1 --seed 1 --sensors
"""

import argparse
from collections.abc import Callable
from types import ModuleType

import numpy as np

from calibration.log_check import commands
from qcar_twin.recordings.checks import acted, answers, driving, neutral, pushes
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.first_dataset import propose, several
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.recording import Recording
from tests.faults import disagreeing
from tests.faults.door.sources import Log, first_car, second_car
from tests.faults.wander import RATE, SIZES, Columns, wander

FACTORS = (0.25, 0.5, 0.7, 1.0, 1.4, 2.0, 4.0)
NUMBERS: tuple[tuple[tuple[ModuleType, ...], str], ...] = (
  *(((driving,), name) for name in ("_ANSWERS", "_SLOWS")),
  ((driving, answers), "RESTS"),
  *(((driving, neutral, acted), "LEAST_REST"), ((driving, neutral), "MOVING")),
  *(((neutral,), name) for name in ("_NEAR", "_MOST", "_OFF", "_RARE", "_NEVER")),
  *(((neutral,), name) for name in ("_BIN", "_GENTLE", "_CENTRED", "_SURE")),
  *(((acted,), name) for name in ("_CONTRARY", "_LEAST_IDLE", "_STAYS", "_SLOWEST", "_LEAP")),
  ((acted, answers), "WEAK"),
  *(((answers,), name) for name in ("_ANSWERED", "_LONGEST_LAG", "_SPEEDS_UP", "_SURE", "_STICKS", "_OFF", "_STOPS")),
  *(((pushes,), name) for name in ("_LONGEST_LAG", "_SLOPE", "_RISE", "_WITNESSED")),
  ((commands, acted), "MUCH"),
)
Drive = tuple[np.ndarray, Columns]
Change = Callable[[np.ndarray, Columns], Drive]


def _column(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
  return lambda time, columns: (time, columns | {name: change(columns[name])})


def _every(count: int) -> Callable[[np.ndarray], np.ndarray]:
  """A slow publisher's values, each held."""
  return lambda values: values[np.arange(values.size) // count * count]


def _stepped(step: float) -> Callable[[np.ndarray], np.ndarray]:
  return lambda values: np.round(values / step) * step


def _commanded(least: float, most: float) -> Callable[[np.ndarray], np.ndarray]:
  """Levels that stay for so many seconds, in the measured speed's place."""

  def change(values: np.ndarray) -> np.ndarray:
    steps = np.random.default_rng(9).uniform(least, most, values.size)
    edges = np.searchsorted(np.cumsum(steps) * RATE, np.arange(values.size))
    first = np.r_[0, np.flatnonzero(np.diff(edges)) + 1]
    return values[first[np.searchsorted(first, np.arange(values.size), side="right") - 1]]

  return change


def _released(seconds: float) -> Change:
  """The car stands, switched off, for so long under a driver who asks for speed."""

  def change(time: np.ndarray, columns: Columns) -> Drive:
    at, count = int(46.0 * RATE), int(seconds * RATE)
    spliced = {name: np.r_[v[:at], np.full(count, v[at]), v[at:]] for name, v in columns.items()}
    spliced["speed"][at : at + count] = 0.005 * np.random.default_rng(4).standard_normal(count)
    spliced["motor_voltage"][at : at + count] = np.percentile(columns["motor_voltage"], 60.0)
    return np.arange(time.size + count) / RATE, spliced

  return change


def _weaker(share: Callable[[np.ndarray], np.ndarray]) -> Change:
  """The car goes along its path at that share of its speed, of time in s, under commands that go on as they were."""

  def change(time: np.ndarray, columns: Columns) -> Drive:
    slow = share(time)
    way = np.r_[0.0, np.cumsum(slow[1:] * np.diff(time))]
    later = {name: np.interp(way, time, values) for name, values in columns.items() if name != "motor_voltage"}
    later["speed"], later["yaw_rate"] = (slow * later[name] for name in ("speed", "yaw_rate"))
    return time, {name: later.get(name, values) for name, values in columns.items()}

  return change


def _browned_out(time: np.ndarray) -> np.ndarray:
  """A second without a supply in every five, from 20 s on."""
  supplied, speed = (time < 20.0) | (time % 5.0 > 1.0), np.ones(time.size)
  for k in range(1, time.size):
    speed[k] = speed[k - 1] + (supplied[k] - speed[k - 1]) / (0.3 * RATE)
  return speed


def _backwards(time: np.ndarray, columns: Columns) -> Drive:
  """Half of the drive in reverse, with its command."""
  sign = np.where((time > 48.0) & (time < 75.0), -1.0, 1.0)
  return time, columns | {name: sign * columns[name] for name in ("speed", "motor_voltage", "yaw_rate")}


def _swift(columns: Columns) -> float:
  """How much faster than a 1:10 car this one is."""
  return 4.0 * float(columns["speed"].sum() / columns["motor_voltage"].sum())


def _driven_so(columns: Columns, time: np.ndarray, speed: np.ndarray, command: np.ndarray) -> Columns:
  """The drive with another speed, which the accelerometer feels, under another command; it goes straight on there."""
  changed = columns | {"speed": speed, "motor_voltage": command}
  if "accel_x" in columns:
    changed["accel_x"] = np.where(speed != columns["speed"], np.gradient(speed, time), columns["accel_x"])
  return changed


def _pushed_on(time: np.ndarray, columns: Columns) -> Drive:
  """A car that rolls out from 60 s to 75 s with nothing commanded, and is pushed forwards twice meanwhile."""
  swift, inside = _swift(columns), (time >= 60.0) & (time < 75.0)
  level = swift * np.array([0.8, 0.4, 1.2, 0.5, 1.3, 0.4])
  at = np.array([60.0, 64.0, 64.0 + 0.8 * swift, 69.0, 69.0 + 0.8 * swift, 75.0])
  noise = 0.005 * np.random.default_rng(3).standard_normal(time.size)
  speed = np.where(inside, np.interp(time, at, level) + noise, columns["speed"])
  return time, _driven_so(columns, time, speed, np.where(inside, 0.0, columns["motor_voltage"]))


def _brakes_first(time: np.ndarray, columns: Columns) -> Drive:
  """A speed controller that takes the first press backwards for a brake, and the second for reverse, every 8 s."""
  swift, phase = _swift(columns), np.where((time > 50.0) & (time < 90.0), (time - 50.0) % 8.0, 8.0)
  inside = phase < 4.0
  edges = [0.0, 0.5, 1.5, 1.7, 3.2, 3.6, 4.0]
  shape = np.interp(phase, edges, [1.2, 0.0, 0.0, -0.5, -0.5, 0.0, 0.6])
  pressed = np.select([phase < 1.2, phase < 1.5, phase < 3.2, phase < 3.6], [-4.0, 0.0, -2.0, 0.0], 2.4)
  noise = 0.005 * np.random.default_rng(3).standard_normal(time.size)
  speed = np.where(inside, swift * shape + noise, columns["speed"])
  return time, _driven_so(columns, time, speed, np.where(inside, pressed, columns["motor_voltage"]))


def _by_pose(time: np.ndarray, columns: Columns) -> Drive:
  return time, {name: values for name, values in columns.items() if name != "speed"}


SOUND: dict[str, Change] = {
  "as it is": lambda t, c: (t, c),
  "speed by the pose": _by_pose,
  "speed of three times the noise": _column(
    "speed", lambda v: v + 0.015 * np.random.default_rng(1).standard_normal(v.size)
  ),
  "speed ten times a second, held": _column("speed", _every(5)),
  "speed four times a second, held": _column("speed", _every(12)),
  "speed in steps of 0.05 m/s": _column("speed", _stepped(0.05)),
  "speed in twelve steps of its top": lambda t, c: (t, c | {"speed": _stepped(c["speed"].max() / 12.0)(c["speed"])}),
  "speed that reads 0.01 m/s at rest": _column("speed", lambda v: v + 0.01),
  "reverse": _backwards,
  "four levels of the command": _column("motor_voltage", _stepped(2.0)),
  "a trim of 0.1 rad": _column("steering_command", lambda v: v + 0.1),
  "a trim of 0.05 rad": _column("steering_command", lambda v: v + 0.05),
}
FALSE: dict[str, tuple[str, Change]] = {
  "neutral of 5 V": ("motor_voltage", _column("motor_voltage", lambda v: v + 5.0)),
  "neutral of 2 V": ("motor_voltage", _column("motor_voltage", lambda v: v + 2.0)),
  "neutral of half the duty": ("motor_voltage", _column("motor_voltage", lambda v: 0.5 + 0.05 * v)),
  "steering about 0.6 rad": ("steering_command", _column("steering_command", lambda v: v + 0.6)),
  "steering about 0.3 rad": ("steering_command", _column("steering_command", lambda v: v + 0.3)),
  "released for 30 s": ("motor_voltage", _released(30.0)),
  "released for 5 s": ("motor_voltage", _released(5.0)),
  "a battery that dies": ("motor_voltage", _weaker(lambda t: np.exp(-np.maximum(t - 60.0, 0.0) / 0.6))),
  "a battery at a third": ("motor_voltage", _weaker(lambda t: np.interp(t, [50.0, 60.0], [1.0, 0.33]))),
  "a battery that browns out": ("motor_voltage", _weaker(_browned_out)),
  "pushed while it rolls": ("motor_voltage", _pushed_on),
  "a controller that brakes first": ("motor_voltage", _brakes_first),
  "commanded speed, 1 to 4 s": ("speed", _column("speed", _commanded(1.0, 4.0))),
  "commanded speed, 0.5 to 3 s": ("speed", _column("speed", _commanded(0.5, 3.0))),
  "commanded speed in steps of a sixth": (
    "speed",
    lambda t, c: (t, c | {"speed": _commanded(0.5, 3.0)(_stepped(c["speed"].max() / 6.0)(c["speed"]))}),
  ),
  "the drive's command with the other sign": ("motor_voltage", _column("motor_voltage", lambda v: -v)),
}


NEUTRALS, SESSIONS = ("neutral of 5 V", "neutral of 2 V"), 8  # of sessions too, where so many drives are made
SEVERAL = ("_ALTERNATIVE", "_CLEAR", "_APART", "_ALIKE", "_MEAN", "_SPIKE", "_SPIKES")
WHEELS = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")
ASKED = "asked"
Case = tuple[str, str, Columns, set[str]]  # name, channel, columns of a log, and which of them may be taken, or ASKED


def several_cases(count: int, seed: int) -> list[Case]:
  """Logs with several sensors of a kind, and which of them is right."""
  random = np.random.default_rng(seed)
  cases: list[Case] = []
  for k in range(count):
    time, own = wander(int(random.integers(2**31)))
    noisy = lambda values, sigma: values + sigma * random.standard_normal(values.size)
    spiking = lambda values: values + 40.0 * (random.random(values.size) < 0.01)
    base = {"time": time, "volts": own["motor_voltage"], "velocity": own["speed"]}
    heading, other = {"heading": own["pose_yaw"]}, np.roll(own["yaw_rate"], time.size // 3)
    gyros = lambda a, b: {"gyro_a": a, "gyro_b": b}
    either, rate = {"gyro_a", "gyro_b"}, own["yaw_rate"]
    wheels = {name: noisy(own["speed"], 0.01) for name in WHEELS}
    slipping = {name: v * (1.05 if name[-2] == "r" else 1.0) for name, v in wheels.items()}
    bad, drift = WHEELS[k % len(WHEELS)], 0.5 * np.sin(0.3 * time)
    still = {"time": time, "volts": own["motor_voltage"], "gyro_z": rate}
    cases += [
      ("two gyros that agree", "yaw_rate", base | gyros(rate, noisy(rate, 0.01)), either),
      ("two gyros, one noisier", "yaw_rate", base | gyros(rate, noisy(rate, 0.05)), either),
      ("two gyros, one of half noise", "yaw_rate", base | gyros(rate, noisy(rate, 0.5 * rate.std())), either),
      ("two gyros, one that drifts", "yaw_rate", base | gyros(rate, rate + drift * rate.std()), {ASKED}),
      ("two gyros that differ", "yaw_rate", base | gyros(rate, other), {ASKED}),
      ("two gyros that differ, and a heading", "yaw_rate", base | heading | gyros(other, rate), {"gyro_b"}),
      ("a noisier gyro, and a heading", "yaw_rate", base | heading | gyros(noisy(rate, 0.1), rate), either),
      ("four wheels, one spikes", "speed", still | wheels | {bad: spiking(wheels[bad])}, {*WHEELS} - {bad}),
      ("four wheels, one hangs", "speed", still | wheels | {bad: noisy(0.0 * time, 0.02)}, {*WHEELS} - {bad}),
      ("four wheels, two slip", "speed", still | slipping, {*WHEELS}),
    ]
  return cases


def wrongly_chosen(cases: list[Case]) -> list[str]:
  """Cases in which a wrong column is taken, or a person is asked for nothing, or not asked."""
  wrong = []
  for name, channel, columns, right in cases:
    proposal = propose("lab", [Table("run.csv", columns, {})])
    asked = any(question.startswith(f"{channel} is ") for question in proposal.questions)
    line = next((text for text in proposal.channels if text.startswith(f"{channel} =")), "")
    taken = ASKED if asked else next((column for column in columns if f'"{column}"' in line), "")
    wrong += [] if taken in right else [name]
  return wrong


Runs = list[Recording]


def drives(count: int, seed: int) -> tuple[list[tuple[str, Runs]], list[tuple[str, str, Runs]]]:
  """Sound drives and false ones of all sizes and of both independent cars, with what is done to each, and the channel
  that is false."""
  random = np.random.default_rng(seed)
  sound, false = [], []
  for k in range(count):
    drive = wander(int(random.integers(2**31)), list(SIZES.values())[k % len(SIZES)])
    sound += [(name, [_recording(change(*drive))]) for name, change in SOUND.items()]
    false += [(name, channel, [_recording(change(*drive))]) for name, (channel, change) in FALSE.items()]
  for make in (first_car, second_car) if count >= SESSIONS else ():
    log = make(seed)
    sound.append((log.source, _session(log)))
    false += [(f"{name}, {log.source}", "motor_voltage", _session(log.changed(FALSE[name][1]))) for name in NEUTRALS]
  return sound, false


def _recording(drive: Drive) -> Recording:
  return with_speed(Recording.from_columns("run", *drive))[0]


def _session(log: Log) -> Runs:
  return [Recording.from_columns(run.file, run.time, run.columns) for run in log.runs]


def errors(sound: list[tuple[str, Runs]], false: list[tuple[str, str, Runs]]) -> tuple[list[str], list[str]]:
  """Sound drives that are blamed, and false ones of whose channel nothing is said."""
  alarms = [name for name, runs in sound if commands.command_findings(runs)]
  said = lambda runs: {channel for f in commands.command_findings(runs) for channel in f.channels}
  return alarms, [name for name, channel, runs in false if channel not in said(runs)]


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--drives", type=int, default=6, help="Of each kind.")
  parser.add_argument("--seed", type=int, default=1, help="Of the drives.")
  parser.add_argument("--sensors", action="store_true", help="The numbers by which two sensors disagree, instead.")
  config = parser.parse_args()
  if config.sensors:
    disagreeing.report(config.drives, config.seed, FACTORS)
    return
  sound, false = drives(config.drives, config.seed)
  print(f"{len(sound)} sound and {len(false)} false drives")
  print("as it is:", *errors(sound, false))
  print("| number | in use | " + " | ".join(f"x {factor:g}" for factor in FACTORS) + " |")
  print("|---" * (2 + len(FACTORS)) + "|")
  for modules, name in NUMBERS:
    value, cells = getattr(modules[0], name), []
    for factor in FACTORS:
      tried = 1.0 - (1.0 - value) / factor if name == "_CONTRARY" else value * factor
      with disagreeing.with_number(modules, name, tried):
        alarms, missed = errors(sound, false)
      cells.append(f"{len(alarms)}, {len(missed)}")
    print(f"| {name} | {value:g} | " + " | ".join(cells) + " |", flush=True)
  cases = several_cases(max(config.drives // 4, 1), config.seed)
  print(f"{len(cases)} logs with several sensors of a kind; wrongly chosen:", *wrongly_chosen(cases))
  for name in SEVERAL:
    value, cells = getattr(several, name), []
    for factor in FACTORS:
      tried = 1.0 - (1.0 - value) * factor if name == "_ALIKE" else value * factor
      with disagreeing.with_number((several,), name, tried):
        cells.append(str(len(wrongly_chosen(cases))))
    print(f"| {name} | {value:g} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
  main()
