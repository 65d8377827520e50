"""Columns whose names say a unit and nothing else that is known, in another language for instance."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.first_dataset.battery import settle_battery
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, scale
from qcar_twin.recordings.first_dataset.heading import unwrap_heading
from qcar_twin.recordings.first_dataset.mount import speeding
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.first_dataset.scales.counter import SLOPE, adds_up, with_slope
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.first_dataset.scales.speed import FOLLOWED, reached
from qcar_twin.recordings.first_dataset.scales.travel import is_pulse, pedals, stick_of
from qcar_twin.recordings.first_dataset.scales.turning import Turning
from qcar_twin.recordings.first_dataset.speeds import follows
from qcar_twin.recordings.unit_names import BRACKET, unit_of, words_of

# a column that is the only one in such a unit -> the channel that it is; those in place of one that is there are none
_ONE = {
  "V": ("motor_voltage", DRIVE_COMMANDS),
  "m/s": ("speed", ("speed", "motor_speed")),
  "rad/s": ("yaw_rate", ("yaw_rate",)),
}
_ONLY = "the only column in such a unit, whatever it is called"
_TURNS_A_MINUTE = {"rpm", "1/min", "tr/min", "u/min", "giri/min", "min-1", "min^-1"}  # that no gyro is read in
# what a servo or the body did, and no command: a body rolls with its turning
_MEASURED = {"measured", "actual", "feedback", "fb", "report", "reported", "roll", "pitch", "rx", "ry", "qpos", "qvel"}
_ACTIONS = {"action", "actions"}
_CONTROLS = {"ctrl"}  # of MuJoCo's actuators, whose drive may be a torque as well as a share
_TURNS = 0.7  # correlation of speed times an angle with the yaw rate, from which the angle is the road wheels'
_FOLLOWS = 0.8  # correlation with the speed, lagged, from which it follows a command, as of two speeds
_LEAST = 10  # bins that a correlation is worth
_ALONG, _CLEARLY = 0.6, 2.0  # correlation of one accelerometer with speeding up, and times that of the other


def guess_by_unit(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Channels of columns that name a unit in brackets and nothing known: the only one of its unit, where no column is
  that channel by name; an angle and two accelerations where the motion confirms them. The battery's voltage first."""
  settle_battery(columns, guesses)
  _only_ones(columns, guesses)
  settle_battery(columns, guesses)  # the only voltage may be the battery's, too
  _accelerations(columns, guesses)
  _steering(columns, guesses)
  _pulses(columns, guesses)
  _beside_the_steering(columns, guesses)
  _actions(columns, guesses)


def _only_ones(columns: Columns, guesses: dict[str, Guess]) -> None:
  for unit, (channel, instead) in _ONE.items():
    names = _unknown(columns, guesses, unit)
    if len(names) == 1 and not guesses.keys() & set(instead):
      _add(columns, guesses, channel, names[0], _ONLY)
  a_minute = lambda name: (unit := unit_of(name)) is not None and unit[0].lower() in _TURNS_A_MINUTE
  turns = [name for name in _unknown(columns, guesses, "rad/s") if a_minute(name)]
  if len(turns) == 1 and not guesses.keys() & {"speed", "motor_speed"}:
    _add(columns, guesses, "motor_speed", turns[0], _ONLY)


def _accelerations(columns: Columns, guesses: dict[str, Guess]) -> None:
  names = _unknown(columns, guesses, CHANNELS["accel_x"].unit)
  if len(names) != 2 or guesses.keys() & {"accel_x", "accel_y"}:
    return
  alike = [abs(speeding(columns, guesses, name)) for name in names]
  ahead = int(np.argmax(alike))
  if alike[ahead] < _ALONG or alike[ahead] < _CLEARLY * alike[1 - ahead]:
    return
  _add(
    columns,
    guesses,
    "accel_x",
    names[ahead],
    f"of two accelerations the one that feels speeding up ({alike[ahead]:.2f})",
  )
  _add(columns, guesses, "accel_y", names[1 - ahead], "the other of two accelerations")


def _steering(columns: Columns, guesses: dict[str, Guess]) -> None:
  names = _unknown(columns, guesses, CHANNELS["steering_command"].unit)
  if not names or "steering_command" in guesses:
    return
  alike = {name: _turning_alike(columns, guesses, name) for name in names}
  best = max(names, key=lambda name: alike[name])
  if alike[best] > _TURNS and all(alike[best] > _CLEARLY * alike[name] for name in names if name != best):
    _add(columns, guesses, "steering_command", best, f"the car turned as this angle says ({alike[best]:.2f})")


def _pulses(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Pulses of a radio control, whatever they are called, and its sticks: the ones that the car turned as and that its
  speed follows. A game's accelerator, whose name says acceleration."""
  is_stick = lambda name: stick_of(columns.names, columns.values, name) is not None
  kind = lambda name: "a radio's stick" if is_stick(name) else "pulses"
  names = [name for name in _free(columns, guesses) if is_pulse(columns.values(name)) or is_stick(name)]
  unwrap_heading(columns, guesses if names else {})  # a log without a gyro turned as it
  seen, told = _by_counts(columns, guesses) if names else (columns, guesses)
  if names:  # what is called a servo and no turning follows is another one's
    called = {guess.column for guess in guesses.values() if guess.channel == "steering_command"}
    turned = {name: _turning(seen, told, name).alike(_LEAST) for name in (*names, *called)}
    alike = {name: abs(one) for name, one in turned.items()}
    best = max(names, key=lambda name: alike[name])
    if alike[best] > _TURNS and all(alike[best] > _CLEARLY * alike[name] for name in turned if name != best):
      _add(columns, guesses, "steering_command", best, f"{kind(best)} that the car turned as ({alike[best]:.2f})")
      if seen is not columns and turned[best] < 0.0:  # else the sign comes with the angle, once the speed is settled
        guesses["steering_command"].reverse("the car turned the other way")
      names.remove(best)
  if names and not guesses.keys() & set(DRIVE_COMMANDS):
    best, alike_best = _followed(seen, told, names)
    if alike_best > _FOLLOWS:
      _add(columns, guesses, "motor_duty", best, f"{kind(best)} that the speed follows ({alike_best:.2f})")
  pedal = [] if guesses.keys() & set(DRIVE_COMMANDS) else pedals(columns.names, columns.values)
  pedal = [name for name in pedal if name in _free(columns, guesses)]
  if len(pedal) == 1:
    _add(columns, guesses, "motor_duty", pedal[0], "an accelerator of whole numbers beside such a brake")


def _by_counts(columns: Columns, guesses: dict[str, Guess]) -> tuple[Columns, dict[str, Guess]]:
  """The logs and what is guessed of them, with a speed, in no unit, by what counts a wheel's or a motor's turning,
  where no other column is one."""
  counters = [name for name in _free(columns, guesses) if adds_up(columns, name)]
  if not counters or guesses.keys() & {"speed", "motor_speed"}:
    return columns, guesses
  return with_slope(columns, counters[0]), {**guesses, "speed": Guess("speed", f"{SLOPE}{counters[0]}")}


def _beside_the_steering(columns: Columns, guesses: dict[str, Guess]) -> None:
  """What the speed follows in a message that holds the steering's command and no sensor, and that stays within 1, is
  the drive's command, a share of full throttle, whatever it is called."""
  steering = guesses.get("steering_command")
  message = _message(steering.column) if steering is not None else ""
  sensors = {_message(guess.column) for name, guess in guesses.items() if CHANNELS[name].kind == "sensor"}
  if not message or message in sensors or guesses.keys() & set(DRIVE_COMMANDS):
    return
  names = [name for name in _free(columns, guesses) if _message(name) == message and columns.top(name) <= 1.0]
  best, alike = _followed(columns, guesses, names)
  if alike > _FOLLOWS:
    why = (
      f"it lies beside the steering in a message of commands, stays within 1, and the speed follows it ({alike:.2f})"
    )
    _add(columns, guesses, "motor_duty", best, why)


def _actions(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Parts of an action, as environments of gymnasium call what they are given: the one that the car turned as steers;
  what the speed follows is a commanded speed where it reaches that, else a duty, where it stays within 1."""
  names = [name for name in _free(columns, guesses) if (_ACTIONS | _CONTROLS) & set(words_of(name))]
  if names and "steering_command" not in guesses:
    alike = {name: _turning_alike(columns, guesses, name, rates=True) for name in names}
    best = max(names, key=lambda name: alike[name])
    if alike[best] > _TURNS and all(alike[best] > _CLEARLY * alike[name] for name in names if name != best):
      _add(
        columns, guesses, "steering_command", best, f"a part of an action that the car turned as ({alike[best]:.2f})"
      )
  taken = {guess.column for guess in guesses.values()}
  names = [name for name in names if name not in taken and _ACTIONS & set(words_of(name))]
  if not names or guesses.keys() & set(DRIVE_COMMANDS) or "speed" not in guesses:
    return
  best, alike_best = _followed(columns, guesses, names)
  trial = {name: guesses[name] for name in ("time", "speed") if name in guesses}
  _add(
    columns, trial, "speed_command", best, f"a part of an action that the speed follows ({alike_best:.2f}) and reaches"
  )
  if alike_best > _FOLLOWS and 1.0 / FOLLOWED < reached(recordings_of(columns, trial), "speed_command") < FOLLOWED:
    guesses["speed_command"] = trial["speed_command"]
  elif alike_best > _FOLLOWS and columns.top(best) <= 1.0:
    _add(
      columns, guesses, "motor_duty", best, f"a part of an action, within 1, that the speed follows ({alike_best:.2f})"
    )


def _message(name: str) -> str:
  """What a name has before its last part: `control_input` of `control_input.steer`."""
  return re.split(r"[./](?=[^./]*$)", name)[0] if re.search(r"[./]", name) else ""


def like_drive(columns: Columns, guesses: dict[str, Guess]) -> str:
  """What a person may look at where no column is the drive's command by name or unit: one of unknown name that the
  speed follows; empty where there is none."""
  names = [] if guesses.keys() & set(DRIVE_COMMANDS) else _free(columns, guesses)
  best, alike = _followed(columns, guesses, names)
  if not best or alike < _FOLLOWS:
    return ""
  kinds = "motor_voltage (V), motor_duty (a share), motor_current (A) or speed_command (m/s)"
  return f"the speed follows '{best}' ({alike:.2f}): map it, if that was commanded, as {kinds}"


def _followed(columns: Columns, guesses: dict[str, Guess], names: Sequence[str]) -> tuple[str, float]:
  """Of these columns the one that a measured speed follows best, and how alike they are, by correlation."""
  speed = next((guesses[name].column for name in ("speed", "motor_speed") if name in guesses), None)
  alike = {name: follows(columns, guesses, speed, name) for name in names} if speed is not None else {}
  best = max(alike, key=lambda name: alike[name], default="")
  return best, alike.get(best, 0.0)


def _free(columns: Columns, guesses: dict[str, Guess]) -> list[str]:
  """Columns that are nothing by name or by guess, change, and say of themselves no measurement."""
  taken = {guess.column for guess in guesses.values()}
  free = [name for name in columns.names if name not in taken and not columns.constant(name) and not readings(name)]
  return [name for name in free if not set(words_of(name)) & _MEASURED]


def like_steering(columns: Columns, guesses: dict[str, Guess]) -> str:
  """What a person may look at where no column is the steering by name or unit: one of unknown name that the car turned
  as, more than as any rate would have it; empty where there is none."""
  if "steering_command" in guesses:
    return ""
  free = _free(columns, guesses)
  alike = {name: _turning_alike(columns, guesses, name, rates=True) for name in free}
  best = max(free, key=lambda name: alike[name], default="")
  if not best or alike[best] < _TURNS:
    return ""
  return f"the car turned as '{best}' says ({alike[best]:.2f}): map it as steering_command, if that was commanded"


def _turning(columns: Columns, guesses: dict[str, Guess], name: str) -> Turning:
  """How the car turned, were this column the steering."""
  trial = dict(guesses)
  _add(columns, trial, "steering_command", name, "")
  return Turning.of(recordings_of(columns, trial))


def _turning_alike(columns: Columns, guesses: dict[str, Guess], name: str, rates: bool = False) -> float:
  """Size of the correlation of speed times an angle with the turning, where it was gentle; 0 where there is none, or,
  with `rates`, where the turning goes more with the column itself, as with a yaw rate."""
  way, angle, turned = _turning(columns, guesses, name).gently
  alike = abs(correlation(way * angle, turned, _LEAST))
  return 0.0 if rates and abs(correlation(angle, turned)) > alike else alike


def _unknown(columns: Columns, guesses: dict[str, Guess], unit: str) -> list[str]:
  """Columns that name a unit of one kind in brackets, are nothing by name and change."""
  taken = {guess.column for guess in guesses.values()}
  said = lambda name: BRACKET.search(name) and (written := unit_of(name)) is not None and written[1] == unit
  free = [name for name in columns.names if name not in taken and said(name)]
  return [
    name for name in free if not readings(name) and not columns.constant(name) and not set(words_of(name)) & _MEASURED
  ]


def _add(columns: Columns, guesses: dict[str, Guess], channel: str, name: str, why: str) -> None:
  guesses[channel] = Guess(channel, name, why=[why])
  scale(columns, guesses[channel])
