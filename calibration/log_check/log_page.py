"""The log itself on a page: traces and map, linked; a verdict of every channel; what sampling and roles rule out."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.log_check.check import LogCheck
from calibration.log_check.disagreements import Finding
from calibration.log_check.motions import Wheels
from calibration.log_check.pairs import Comparison
from qcar_twin.pages import Cell, Explorer, Line, Panel, Route, Run, Section, Table
from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
_WINDOW = 0.1  # s, over which a rate is taken from what was added up
_COLOURS = {"spoils": "red", "beware": "amber", "note": "green"}
_SHOWN = ("steering_command", "speed", "yaw_rate", "accel_x", "accel_y")


def log_sections(check: LogCheck) -> list[Section]:
  """Traces and map, then channel by channel; what the page of a log begins with."""
  vehicle = Vehicle.from_dataset(check.dataset.vehicle, check.dataset.vehicle_std)
  recordings = check.dataset.recordings
  wheels = Wheels.of(vehicle, recordings)
  longest = max(recordings, key=lambda r: r.duration)  # the page opens with it; a standstill would be an empty picture
  runs = [_run(r, wheels, vehicle.wheelbase) for r in (longest, *(r for r in recordings if r is not longest))]
  caption = (
    "In black what was logged, in colour what other channels say of the same motion: the slope of the heading, speed"
    " times yaw rate, the change of speed. Click the map to see that moment."
  )
  return [
    Section("The log", limits(recordings), figures=[Explorer(caption, runs, level="speed [m/s]")]),
    Section("Channel by channel", "", [channel_table(check)]),
  ]


def channel_table(check: LogCheck) -> Table:
  """Every channel with green, amber or red, the sentence behind it, and the cure where there is one."""
  rows: list[Sequence[Cell]] = []
  for sampling in check.samplings:
    colour, sentence = channel_verdict(check, sampling.channel)
    rows.append([sampling.channel, CHANNELS[sampling.channel].unit, sampling.publishes, colour, sentence])
  return Table("Verdict of each channel", ("channel", "unit", "new [Hz]", "verdict", "why, and what to do"), rows)


def channel_verdict(check: LogCheck, channel: str) -> tuple[str, str]:
  """ "green", "amber" or "red", and a sentence: the worst findings about a channel, else who agrees with it.

  Of sensors that contradict each other those are not blamed that geometry confirms, where another is not confirmed.
  """
  about = [f for f in check.findings if _names(f, channel) and f.severity != "note"]
  confirmed = _confirmations(check, channel)
  other = lambda f: [n for n in f.channels if n != channel and not _confirmations(check, n)]
  blamed = [f for f in about if not (f.severity == "spoils" and confirmed and other(f))]
  if blamed:
    worst = blamed[0].severity  # they come worst first
    return _COLOURS[worst], " · ".join(f.text for f in blamed if f.severity == worst)
  if about:
    return "green", f"{'; '.join(confirmed)}; {' and '.join(other(about[0]))} contradict it, and nothing confirms them"
  compared = [_agreement(c, channel) for c in _comparisons(check, channel)]
  if not compared:
    return "green", "no other channel of this log tells anything of it: not contradicted, and not confirmed"
  return "green", "; ".join(compared)


def _comparisons(check: LogCheck, channel: str) -> list[Comparison]:
  return [c for c in check.comparisons if channel in (*c.motion.compared, *c.motion.reference) and not c.why_not]


def _confirmations(check: LogCheck, channel: str) -> list[str]:
  """Which sensors agree with a channel by geometry, in words."""
  spoiling = {f.channels for f in check.of("spoils")}
  return [
    _agreement(c, channel)
    for c in _comparisons(check, channel)
    if c.motion.kinematic and (*c.motion.compared, *c.motion.reference) not in spoiling
  ]


def _names(finding: Finding, channel: str) -> bool:
  if finding.channels:
    return channel in finding.channels
  return any(word.strip(",;:()'") == channel for word in finding.text.split())


def _agreement(c: Comparison, channel: str) -> str:
  others = [n for n in (*c.motion.compared, *c.motion.reference) if n != channel]
  return f"agrees with {' and '.join(others)} in {c.motion.name} (correlation {c.correlation:.3f})"


def limits(recordings: Sequence[Recording]) -> str:
  """What the sampling and the number of recordings rule out, as a list."""
  lines = []
  steps = {
    name: float(np.median(np.concatenate([np.diff(r[name].time) for r in recordings if name in r])))
    for name in (*DRIVE_COMMANDS, *_SHOWN, "motor_speed", "pose_x")
    if any(name in r and len(r[name]) > 1 for r in recordings)
  }
  if steps:
    slowest = max(steps, key=lambda name: steps[name])
    lines.append(
      f"* {slowest} comes {1.0 / steps[slowest]:.3g} times a second: no delay of it below {1e3 * steps[slowest]:.0f} ms"
      " can be seen."
    )
  roles = {r.role for r in recordings}
  if not roles & {"validate", "holdout"}:
    lines.append("* No recording is kept to judge by: a model that fits this log may fit nothing else.")
  if not any({"pose_x", "pose_y"} <= set(r.channels) for r in recordings):
    lines.append("* No pose was logged: where the car went, slip and a wheel's radius cannot be seen.")
  if any(r.derived for r in recordings):
    derived = sorted({name for r in recordings for name in r.derived})
    lines.append(
      f"* {', '.join(derived)} was not logged but follows from other channels, and tells nothing of its own."
    )
  return "\n".join(lines)


def _run(recording: Recording, wheels: Wheels, wheelbase: float) -> Run:
  panels = [Panel(_title(n), [_measured(recording, n)]) for n in DRIVE_COMMANDS if n in recording]
  if "steering_command" in recording:
    panels.append(Panel(_title("steering_command"), [_measured(recording, "steering_command")]))
  speed = _speed(recording, wheels)
  panels += _speed_panel(recording, speed)
  panels += _turning_panel(recording, speed, wheelbase)
  panels += _acceleration_panels(recording, speed)
  route = None
  if {"pose_x", "pose_y"} <= set(recording.channels):
    x, y = recording["pose_x"], recording["pose_y"]
    level = np.abs(np.interp(x.time, *speed)) if speed is not None else None
    route = Route(x.time, x.value, y.interpolate(x.time), level)
  return Run(recording.name, panels, route, note=f"{recording.role}, {recording.duration:.0f} s")


def _title(channel: str) -> str:
  return f"{channel.replace('_', ' ')} [{CHANNELS[channel].unit}]"


def _measured(recording: Recording, channel: str) -> Line:
  stream = recording[channel]
  return Line("measured", stream.time, stream.value, channel.replace("_", " "))


def _speed(recording: Recording, wheels: Wheels) -> tuple[Array, Array] | None:
  if wheels.channel not in recording:
    return None
  stream = recording[wheels.channel]
  return stream.time, wheels.scale * stream.value


def _speed_panel(recording: Recording, speed: tuple[Array, Array] | None) -> list[Panel]:
  lines = [Line("measured", *speed, "speed")] if speed is not None else []
  if {"pose_x", "pose_y"} <= set(recording.channels) and len(recording["pose_x"]) > 2:
    time = recording["pose_x"].time
    along, across = _slope(recording, "pose_x", time), _slope(recording, "pose_y", time)
    moved, said = np.hypot(along, across), "of the pose, its size"
    if "pose_yaw" in recording:
      heading = recording["pose_yaw"].interpolate(time)
      moved, said = np.cos(heading) * along + np.sin(heading) * across, "of the pose, along the heading"
    lines.append(Line("bicycle", time, moved, said))
  return [Panel("speed [m/s]", lines)] if lines else []


def _turning_panel(recording: Recording, speed: tuple[Array, Array] | None, wheelbase: float) -> list[Panel]:
  lines = [_measured(recording, "yaw_rate")] if "yaw_rate" in recording else []
  if "pose_yaw" in recording and len(recording["pose_yaw"]) > 2:
    time = recording["pose_yaw"].time
    lines.append(Line("bicycle", time, _slope(recording, "pose_yaw", time), "slope of the heading"))
  if "steering_command" in recording and speed is not None:
    time, value = speed
    turn = value * np.tan(np.clip(recording["steering_command"].at(time), -1.2, 1.2)) / wheelbase
    lines.append(Line("twin", time, turn, "speed × tan(steering) / wheelbase"))
  return [Panel("yaw rate [rad/s]", lines)] if lines else []


def _acceleration_panels(recording: Recording, speed: tuple[Array, Array] | None) -> list[Panel]:
  panels = []
  if "accel_x" in recording:
    lines = [_measured(recording, "accel_x")]
    if speed is not None and len(speed[0]) > 2:
      lines.append(Line("bicycle", speed[0], _difference(*speed, speed[0]), "change of speed"))
    panels.append(Panel("acceleration along [m/s²]", lines))
  if "accel_y" in recording:
    lines = [_measured(recording, "accel_y")]
    if speed is not None and "yaw_rate" in recording:
      time = recording["yaw_rate"].time
      lines.append(Line("bicycle", time, np.interp(time, *speed) * recording["yaw_rate"].value, "speed × yaw rate"))
    elif speed is not None and "pose_yaw" in recording and len(recording["pose_yaw"]) > 2:
      time = recording["pose_yaw"].time
      turn = np.interp(time, *speed) * _slope(recording, "pose_yaw", time)
      lines.append(Line("bicycle", time, turn, "speed × slope of the heading"))
    panels.append(Panel("acceleration across [m/s²]", lines))
  return panels


def _slope(recording: Recording, channel: str, time: Array) -> Array:
  return _difference(recording[channel].time, recording[channel].value, time)


def _difference(at: Array, value: Array, time: Array) -> Array:
  """Central difference over a window of a few samples, NaN at the ends."""
  half = max(0.5 * _WINDOW, 1.5 * float(np.median(np.diff(at))))
  inside = (time - half >= at[0]) & (time + half <= at[-1])
  change = np.interp(time + half, at, value) - np.interp(time - half, at, value)
  return np.where(inside, change / (2.0 * half), np.nan)
