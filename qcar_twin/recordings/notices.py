"""Warnings about a data set, each kind once."""

import re
from collections.abc import Iterable

_NUMBER = re.compile(r"[-+.\d]+(e[-+]?\d+)?")


def gathered(warnings: Iterable[str]) -> tuple[str, ...]:
  """The same, with one for all that differ in nothing but a file's name and numbers."""
  by_text: dict[str, list[str]] = {}
  for warning in warnings:
    by_text.setdefault(_NUMBER.sub("#", warning.partition(": ")[2] or warning), []).append(warning)
  more = lambda count: f" (and {count} more like it)" if count else ""
  return tuple(f"{group[0]}{more(len(group) - 1)}" for group in by_text.values())
