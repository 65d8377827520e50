"""In which unit a log's clock counts: by its steps, where these are too small for seconds by its name or its size."""

from qcar_twin.recordings.unit_names import words_of

TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))
LONGEST_STEP = 0.5  # s from row to row of a log
_SHORTEST_STEP = 2e-5  # s, below which the loader takes no step for one in seconds
_LONG = {
  "minutes": (60.0, {"min", "mins", "minute", "minutes"}),
  "hours": (3600.0, {"h", "hr", "hour", "hours"}),
  "days": (86400.0, {"d", "day", "days", "datenum", "datetime", "date"}),
}
_DATE = 20000.0  # days: spreadsheets count 45000 since 1900, MATLAB 739000 since the year 0; hours are two years


_TODAY = (9.8e8, 4.1e9)  # s since 1970, of the years 2001 to 2099
_SLOWEST = 10.0  # s, of satellites and thermometers, whose stamps tell their unit by the date


def unit_of_clock(name: str, step: float, last: float) -> tuple[float, str] | None:
  """The factor to s and the unit's name of a clock with this usual step and last reading; None where none fits."""
  if 0.0 < step < _SHORTEST_STEP:
    words = set(words_of(name))
    for unit, (seconds, names) in _LONG.items():
      if (words & names or (unit == "days" and last > _DATE)) and _SHORTEST_STEP < step * seconds <= LONGEST_STEP:
        return seconds, unit
  for factor, unit in TIMES:
    if _TODAY[0] < factor * last < _TODAY[1] and step * factor <= _SLOWEST:
      return factor, unit
  return next(((factor, unit) for factor, unit in TIMES if step * factor <= LONGEST_STEP), None)
