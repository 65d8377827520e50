"""Stamps that a spreadsheet or a logger writes as text: 01.03.2026 14:00:01,25, 3/1/2026 2:00:01 PM, 14:00:01:250; and
durations: MATLAB's `0.02 sec`, pandas' `0 days 00:00:00.020000`."""

from __future__ import annotations

import calendar
import re

import numpy as np

_STAMP = re.compile(
  r"^\s*(?:(?:(?P<a>\d{1,2})(?P<mark>[./-])(?P<b>\d{1,2})(?P=mark)(?P<year>\d{4})"
  r"|(?P<year_first>\d{4})[/.](?P<month>\d{1,2})[/.](?P<day>\d{1,2}))[ T,]+)?"
  r"(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2}(?:[.,]\d+|:\d{3})?)(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?\s*$"
)
_DAY = 86400.0  # s
_DURATION = re.compile(r"^\s*(?P<value>[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*(?P<unit>ms|s|sec|min|hr|h)\s*$")
_SECONDS = {"ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "hr": 3600.0, "h": 3600.0}
_DAYS = re.compile(r"^\s*(?P<days>-?\d+) days?,? \+?(?P<hour>\d+):(?P<minute>\d{2}):(?P<second>\d{2}(?:\.\d+)?)\s*$")
_MONTHS = 12


def seconds_of(texts: list[object]) -> np.ndarray | None:
  """Seconds since 1970, or since midnight where no date is given, of each text, NaN where there is none; None where a
  text is no such stamp.

  Of 1/3/2026 the month comes first, as in the US, unless a number beyond 12 says otherwise; of 1.3.2026 and 1-3-2026
  the day does. A time of day that falls by half a day and more has passed midnight.
  """
  if (durations := _durations(texts)) is not None:
    return durations
  matches = [None if text is None else _STAMP.match(str(text)) for text in texts]
  if not any(matches) or any(match is None and text is not None for match, text in zip(matches, texts, strict=True)):
    return None
  day_first = any(m["mark"] in (".", "-") or int(m["a"]) > _MONTHS for m in matches if m and m["year"])
  try:
    values = np.array([np.nan if m is None else _seconds(m, day_first) for m in matches])
  except ValueError:
    return None
  if not any(m["year"] or m["year_first"] for m in matches if m):
    there = np.isfinite(values)
    falls = np.diff(values[there], prepend=values[there][:1]) < -0.5 * _DAY
    values[there] += _DAY * np.cumsum(falls)
  return values


def _durations(texts: list[object]) -> np.ndarray | None:
  """Seconds of durations, NaN where there is none; None where a text is none."""
  if not any(_DURATION.match(str(text)) or _DAYS.match(str(text)) for text in texts[:1]):
    return None
  values = np.full(len(texts), np.nan)
  for k, text in enumerate(texts):
    if text is None:
      continue
    if (match := _DURATION.match(str(text))) is not None:
      values[k] = float(match["value"]) * _SECONDS[match["unit"]]
    elif (match := _DAYS.match(str(text))) is not None:
      days, hour, minute = (int(match[part]) for part in ("days", "hour", "minute"))
      values[k] = _DAY * days + 3600.0 * hour + 60.0 * minute + float(match["second"])
    else:
      return None
  return values


def _seconds(match: re.Match[str], day_first: bool) -> float:
  hour = int(match["hour"])
  if match["half"]:
    hour = hour % 12 + (12 if match["half"] in "Pp" else 0)
  clock = 3600.0 * hour + 60.0 * int(match["minute"]) + float(match["second"].replace(",", ".").replace(":", "."))
  if match["year_first"]:
    year, month, day = (int(match[part]) for part in ("year_first", "month", "day"))
  elif match["year"]:
    year, month, day = (int(match[part]) for part in (("year", "b", "a") if day_first else ("year", "a", "b")))
  else:
    return clock
  if not 1 <= month <= _MONTHS or not 1 <= day <= calendar.monthrange(year, month)[1]:
    raise ValueError(f"{match[0]} is no date")
  return float(calendar.timegm((year, month, day, 0, 0, 0))) + clock
