"""Units as people write them in the names of a log's columns."""

import math
import re

from qcar_twin.recordings.channels import GRAVITY
from qcar_twin.recordings.languages import in_english, of_east, plain

_ALONE = ("rpm", "rps", "erpm")  # units that are a name by themselves
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_EAST = re.compile(r"([\u3041-\u30ff\u3400-\u9fff\uac00-\ud7a3]+)")  # kana, ideographs and hangul
# of its driver's topics: what a VESC measures, and is set to, in electrical revolutions a minute
_VESC_SPEEDS = ({"sensors", "core", "speed"}, {"vesc", "state", "speed"}, {"commands", "motor", "speed"})
# the ends of names that an ODrive's axes have for what they measure and are set to, of firmware 0.5 and later (its API
# reference, "ODrive.Axis", "ODrive.Controller" and "ODrive.Motor"); before it counts of the encoder stood for turns
_ODRIVE: dict[tuple[str, ...], str] = {
  **dict.fromkeys((("vel", "estimate"), ("input", "vel"), ("vel", "setpoint")), "turns/s"),
  **dict.fromkeys((("pos", "estimate"), ("input", "pos"), ("pos", "setpoint")), "turns"),
  **dict.fromkeys((("iq", "measured"), ("iq", "setpoint")), "A"),
}
_ODRIVES = {"odrive", "odrv", "axis"}
BRACKET = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")
ELEMENT = re.compile(r"(?:\[(?P<zero>\d+)\]|\((?P<one>\d+)\))\s*$")
# words that say that something was asked for, and not measured
COMMANDED = (
  "command", "commands", "commanded", "cmd", "target", "desired", "des", "setpoint", "set", "ref", "reference", "goal",
  "req", "request", "requested", "demand", "demanded", "wanted",
)  # fmt: skip
_AXES = {"xyz", "xy"}  # names of a vector that has so many elements
VECTORS = {*_AXES, "acc", "accel", "accelerometer", "acceleration", "gyro", "gyroscope", "gyr"}

# a unit as people write it -> the SI unit it is of, and the factor to it
UNITS: dict[str, tuple[str, float]] = {
  **dict.fromkeys(("s", "sec", "secs", "seconds"), ("s", 1.0)),
  **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), ("s", 1e-3)),
  **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds"), ("s", 1e-6)),
  **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds", "nanosec"), ("s", 1e-9)),
  **dict.fromkeys(("rad", "radians"), ("rad", 1.0)),
  **dict.fromkeys(("mrad",), ("rad", 1e-3)),
  **dict.fromkeys(("deg", "degrees", "degree", "°"), ("rad", math.pi / 180.0)),
  **dict.fromkeys(("turns",), ("rad", math.tau)),
  **dict.fromkeys(("rad/s", "rads", "radps", "radsec", "rad/sec"), ("rad/s", 1.0)),
  **dict.fromkeys(
    ("deg/s", "dps", "degs", "degps", "°/s", "degsec", "deg/sec", "degrees/s", "degrees/sec", "°/sec"),
    ("rad/s", math.pi / 180.0),
  ),
  **dict.fromkeys(("mrad/s", "mrads", "mradps"), ("rad/s", 1e-3)),
  **dict.fromkeys(("mdps", "mdeg/s"), ("rad/s", 1e-3 * math.pi / 180.0)),
  **dict.fromkeys(
    ("rpm", "1/min", "erpm", "tr/min", "u/min", "giri/min", "min-1", "min^-1"), ("rad/s", math.tau / 60.0)
  ),
  **dict.fromkeys(("rps", "rev/s", "turn/s", "turns/s", "1/s"), ("rad/s", math.tau)),
  **dict.fromkeys(("m/s", "mps", "m/sec", "meters/per/sec", "metres/per/sec", "meters/per/second"), ("m/s", 1.0)),
  **dict.fromkeys(("km/h", "kmh", "kph", "kmph"), ("m/s", 1 / 3.6)),
  **dict.fromkeys(("mph", "mi/h"), ("m/s", 0.44704)),
  **dict.fromkeys(("knots", "knot", "kts", "kt", "kn"), ("m/s", 1852.0 / 3600.0)),
  **dict.fromkeys(("cm/s", "cms", "cmps"), ("m/s", 0.01)),
  **dict.fromkeys(("in/s", "in/sec", "inches/s", "inches/sec"), ("m/s", 0.0254)),
  **dict.fromkeys(("mm/s", "mms", "mmps"), ("m/s", 0.001)),
  **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "mps2", "mss"), ("m/s^2", 1.0)),
  **dict.fromkeys(("cm/s2", "cm/s^2", "cm/s²", "cms2", "cmps2"), ("m/s^2", 0.01)),
  **dict.fromkeys(("mm/s2", "mm/s^2", "mm/s²", "mms2", "mmps2"), ("m/s^2", 0.001)),
  **dict.fromkeys(("ft/s2", "ft/s^2", "ft/s²"), ("m/s^2", 0.3048)),
  **dict.fromkeys(("g",), ("m/s^2", GRAVITY)),
  **dict.fromkeys(("mg",), ("m/s^2", GRAVITY / 1000.0)),
  **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), ("m", 1.0)),
  **dict.fromkeys(("km",), ("m", 1000.0)),
  **dict.fromkeys(("inch", "inches"), ("m", 0.0254)),
  **dict.fromkeys(("cm",), ("m", 0.01)),
  **dict.fromkeys(("mm",), ("m", 0.001)),
  **dict.fromkeys(("v", "volt", "volts"), ("V", 1.0)),
  **dict.fromkeys(("mv", "millivolts"), ("V", 0.001)),
  **dict.fromkeys(("a", "amp", "amps"), ("A", 1.0)),
  **dict.fromkeys(("ma", "milliamps"), ("A", 0.001)),
  **dict.fromkeys(("%", "pct", "percent", "percentage"), ("-", 0.01)),
}

# units whose letters are words of names elsewhere: SteerIn is no length
_BRACKETED = {
  **{"in": ("m", 0.0254), "ips": ("m/s", 0.0254), "ft": ("m", 0.3048), "ft/s": ("m/s", 0.3048)},
  **dict.fromkeys(("grad", "grados", "degrés", "gradi"), UNITS["deg"]),  # as degrees are called elsewhere
  **dict.fromkeys(("grad/s", "grados/s", "degrés/s", "gradi/s"), UNITS["deg/s"]),
}


def bracketed(column: str) -> str:
  """A name whose unit stands behind "in", "v in km/h", with it in brackets: "v [km/h]"."""
  what, _, unit = column.rpartition(" in ")
  return f"{what} [{unit.strip()}]" if what and (unit.strip().lower() in UNITS.keys() | _BRACKETED.keys()) else column


def words_of(column: str) -> tuple[str, ...]:
  """Lower-case English words of a name: "steeringAngle [deg]" has steering, angle, deg, and so has "Lenkwinkel [deg]".
  An element of a vector goes by its axis: "accelerometer_m_s2[0]" has x, and so has MATLAB's "gyro(1)"."""
  words: tuple[str, ...] = ()
  for place, part in enumerate(_EAST.split(column)):
    western = _WORD.findall(plain(part)) if place % 2 == 0 else ()
    words += of_east(part) if place % 2 else tuple(english for word in western for english in in_english(word.lower()))
  if (element := ELEMENT.search(column)) is None or not set(words) & VECTORS:
    return words
  first = 0 if element["zero"] else 1
  place = int(element["zero"] or element["one"]) - first
  length = 2 if "xy" in words else 3
  return (*(word for word in words[:-1] if word not in _AXES), "xyz"[place]) if 0 <= place < length else words


def is_electrical(column: str) -> bool:
  """Whether a column counts revolutions of a motor's field, as electronic commutators do."""
  words = set(words_of(column))
  return "erpm" in words or {"e", "rpm"} <= words or any(words >= speed for speed in _VESC_SPEEDS)


def is_odrive(column: str) -> bool:
  """Whether a column is called as what an axis of an ODrive measures, or is set to."""
  words = words_of(column)
  return words[-2:] in _ODRIVE and bool(_ODRIVES & set(words[:-2]))


def unit_of(column: str) -> tuple[str, str, float] | None:
  """The unit a name ends with, has in brackets or is, or rpm anywhere: as written, the SI unit it is of, the factor to
  it."""
  for inside in BRACKET.findall(column := bracketed(column)):
    written = inside.strip().lower()
    if unit := UNITS.get(written) or _BRACKETED.get(written):
      return (inside.strip(), *unit)
  *before, last = column.split() or [""]
  if before and (written := last.lower()) in UNITS and not written.isalpha():  # Throttle %, Speed m/s
    return (last, *UNITS[written])
  if column.endswith("%"):  # throttle%
    return ("%", *UNITS["%"])
  words = words_of(BRACKET.sub(" ", column))
  if any(speed <= set(words) for speed in _VESC_SPEEDS):
    return ("erpm", *UNITS["erpm"])
  if is_odrive(column):
    return (unit := _ODRIVE[words[-2:]], *UNITS[unit.lower()])
  if len(words) == 1 and words[0] in _ALONE:
    return (words[0], *UNITS[words[0]])
  for count in (3, 2):
    if len(words) == count and (written := words[0] + "/" + "".join(words[1:])) in UNITS:
      return (written, *UNITS[written])  # mm_s: it is nothing but a unit
  for count in (3, 2, 1):
    if len(words) > count:
      tail = words[-count:]
      for written in ("/".join(tail), tail[0] + "/" + "".join(tail[1:]), "".join(tail)):
        if written in UNITS:
          return (written, *UNITS[written])
  return ("rpm", *UNITS["rpm"]) if "rpm" in words else None  # motor_rpm_cmd
