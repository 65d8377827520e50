"""The page of the Python interface, made from signatures and docstrings.

`python -m docs.make.api` writes docs/reference/api.md.
"""

import ast
import inspect
import re
import textwrap
from importlib import import_module
from pathlib import Path
from typing import Any

from qcar_twin.atomic_io import write_text

PAGE = Path(__file__).parents[1] / "reference" / "api.md"
INTRODUCTION = """# Python interface

What a person imports, by subject. Quantities are in SI units, axes and signs those of ISO 8855. (N, P) is an array's
shape.
Examples that run: [a twin file](../guide/twin.md), [the environment](../guide/environment.md),
[diagnosis](../guide/diagnosis.md), [recordings](recordings.md). This page is written by `make docs`.
"""
# subject -> module -> names
INTERFACE: dict[str, dict[str, tuple[str, ...]]] = {
  "Recordings and cars": {"qcar_twin": ("DataSet", "Recording", "RecordingError", "Vehicle")},
  "Twins and plants": {
    "qcar_twin": ("Twin", "load_twin", "save_twin", "Bicycle"),
    "qcar_twin.plant": ("Plant", "Segments", "Prediction"),
    "qcar_twin.parameters": ("Parameter", "ParameterSet"),
    "qcar_twin.twin.mechanisms": ("add_file", "catalogue", "select"),
  },
  "Calibration and diagnosis": {
    "calibration": ("identify", "calibrate", "cross_validate", "diagnose"),
    "calibration.twin_calibration.calibration": ("Calibration", "Estimate"),
    "calibration.cross_validation.cross_validation": ("CrossValidation",),
    "calibration.diagnosis.outcome": ("Outcome", "Diagnosis"),
    "calibration.diagnosis.search.structure": ("Effort",),
  },
  "Sessions with a concealed effect": {"calibration": ("make_session", "draw_cases", "run_case")},
  "Environments": {
    "agents.learning.environments": ("Options", "make_env", "fleet"),
    "qcar_twin.envs.vector_env": ("FleetVecEnv",),
  },
  "Control and estimation": {
    "agents.control.interface": ("Controller", "Situation"),
    "agents.control.closed_loop": ("Scenario", "Drive", "drive"),
    "qcar_twin.estimation.federated": ("FederatedFilter",),
    "qcar_twin.estimation.offline": ("filter_recording",),
  },
  "Pages": {"qcar_twin.pages": ("Section", "Chart", "Table", "write_page")},
}
_LISTS = re.compile(r"^(Args|Attributes|Raises|Returns):$")
_ENTRY = re.compile(r"^  (\S.*)$")


def names() -> list[tuple[str, str, str]]:
  """(subject, module, name) of everything on the page, in its order."""
  return [(s, m, n) for s, modules in INTERFACE.items() for m, listed in modules.items() for n in listed]


def signature(thing: Any) -> str:
  """A function's or class's head as its source writes it; a dataclass's fields, one a line."""
  tree = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
  if isinstance(tree, ast.FunctionDef):
    returned = f" -> {ast.unparse(tree.returns)}" if tree.returns else ""
    return _wrapped(tree.name, _arguments(tree.args), returned)
  assert isinstance(tree, ast.ClassDef)
  made = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"]
  if made:
    return _wrapped(tree.name, _arguments(made[0].args)[1:])
  fields = [ast.unparse(node) for node in tree.body if isinstance(node, ast.AnnAssign)]
  return _wrapped(tree.name, fields) if fields else f"{tree.name}({', '.join(map(ast.unparse, tree.bases))})"


def _arguments(arguments: ast.arguments) -> list[str]:
  """One text an argument, with its annotation and default."""
  positional = [*arguments.posonlyargs, *arguments.args]
  bare = len(positional) - len(arguments.defaults)
  written = [ast.unparse(a) for a in positional[:bare]]
  for one, default in zip(positional[bare:], arguments.defaults, strict=True):
    written.append(f"{ast.unparse(one)}{' = ' if one.annotation else '='}{ast.unparse(default)}")
  if arguments.vararg:
    written.append(f"*{ast.unparse(arguments.vararg)}")
  for one, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
    written.append(ast.unparse(one) + (f" = {ast.unparse(default)}" if default else ""))
  return written + ([f"**{ast.unparse(arguments.kwarg)}"] if arguments.kwarg else [])


def _wrapped(name: str, parts: list[str], end: str = "") -> str:
  line = f"{name}({', '.join(parts)}){end}"
  return line if len(line) <= 100 else f"{name}(\n" + "".join(f"  {part},\n" for part in parts) + f"){end}"


def prose(text: str) -> str:
  """A docstring in Markdown: its lists of arguments, attributes and errors become lists."""
  lines, listing = [], False
  for line in text.splitlines():
    if _LISTS.match(line):
      lines, listing = [*lines, f"*{line.rstrip(':')}*", ""], True
    elif listing and (entry := _ENTRY.match(line)) and not line.startswith("    "):
      lines.append(f"* {entry[1]}")
    elif listing and line.startswith("    "):
      lines.append(f"  {line.strip()}")
    else:
      lines, listing = [*lines, line], listing and not line.strip()
  return "\n".join(lines)


def methods(thing: Any) -> list[str]:
  """A class's public methods and properties with the first line of what they say."""
  if not inspect.isclass(thing):
    return []
  listed = []
  for name, member in vars(thing).items():
    inner = member.__func__ if isinstance(member, classmethod) else getattr(member, "fget", member)
    if not name.startswith("_") and inspect.isfunction(inner) and inner.__doc__:
      first = inspect.cleandoc(inner.__doc__).split("\n\n")[0]
      listed.append(f"* `{name}`: {' '.join(first.split())}")
  return listed


def entry(module: str, name: str) -> list[str]:
  """Heading, import, signature, docstring and methods of one name."""
  thing = getattr(import_module(module), name)
  said = prose(inspect.getdoc(thing) or "")
  lines = ["", f"### {name}", "", f"`from {module} import {name}`", "", "```text", signature(thing), "```", "", said]
  more = methods(thing)
  return [*lines, "", *more] if more else lines


def page() -> str:
  """The whole interface in Markdown."""
  lines, last = [INTRODUCTION.rstrip()], ""
  for subject, module, name in names():
    if subject != last:
      lines, last = [*lines, "", f"## {subject}"], subject
    lines += entry(module, name)
  return re.sub(r"\n{3,}", "\n\n", "\n".join(line.rstrip() for line in lines)) + "\n"


if __name__ == "__main__":
  write_text(PAGE, page())
