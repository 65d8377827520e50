"""Numbers of the flat and nested YAML files that exports write, read back without a YAML package."""

from collections.abc import Mapping
from pathlib import Path

_EXTRA = "#: "  # begins a comment that holds a number for which the format has no key


def yaml_lines(values: Mapping[str, object], about: Mapping[str, str], indent: str = "") -> list[str]:
  """`key: value  # about` a line; a mapping is nested."""
  lines = []
  for key, value in values.items():
    said = f"  # {about[key]}" if key in about else ""
    if isinstance(value, Mapping):
      lines += [f"{indent}{key}:{said}", *yaml_lines(value, about, indent + "  ")]
    else:
      shown = repr(float(value)) if isinstance(value, float) else str(value)
      lines.append(f"{indent}{key}: {shown}{said}")
  return lines


def extra_lines(values: Mapping[str, object], about: Mapping[str, str]) -> list[str]:
  """Numbers that the format has no key for, as comments that `read_numbers` reads."""
  return [f"{_EXTRA}{line}" for line in yaml_lines(values, about)]


def read_numbers(path: Path) -> dict[str, float]:
  """Every number by its key, nested ones as `outer.inner`, those in comments included."""
  numbers: dict[str, float] = {}
  outer: list[str] = []
  for raw in path.read_text(encoding="utf-8").splitlines():
    line = raw.removeprefix(_EXTRA)
    body = line.partition(" #")[0].rstrip()
    if not body.strip() or body.lstrip().startswith("#"):
      continue
    depth = (len(body) - len(body.lstrip())) // 2
    key, _, value = body.strip().partition(":")
    outer = [*outer[:depth], key]
    try:
      numbers[".".join(outer)] = float(value)
    except ValueError:
      continue
  return numbers
