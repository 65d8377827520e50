"""`qcar-twin COMMAND [options]`: lists the commands, runs one of them, says in a sentence what went wrong."""

import ast
import difflib
import importlib
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from qcar_twin.command_line import FAILED, MISUSED, run

USAGE = """usage: qcar-twin [--traceback] COMMAND [options]

use
{use}

measure
{measure}

`qcar-twin COMMAND --help` lists the options with their units; with --traceback an error says where it arose."""

# in the order in which they are met; every other command measures this project itself
USE = ("run", "new", "look", "check", "calibrate", "cross-validate", "diagnose", "curves")
USE += ("scan", "watch", "drive", "estimate", "track", "train", "render", "export")
ALIASES = {"characterise": "curves", "shadow": "watch"}


def commands() -> dict[str, str]:
  """Name -> what the command does, the first line of its file's docstring; nothing is imported."""
  files = sorted(Path(__file__).parent.glob("[!_]*.py"))
  said = {path.stem: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" for path in files}
  return {stem.replace("_", "-"): text.partition("\n")[0] for stem, text in said.items()}


def usage() -> str:
  """The list of commands, those that one uses before those that measure the project."""
  known = commands()
  lines = {name: f"  {name:<26}{text}" for name, text in known.items()}
  return USAGE.format(
    use="\n".join(lines[name] for name in USE if name in lines),
    measure="\n".join(line for name, line in lines.items() if name not in USE),
  )


def dispatch(words: list[str]) -> int:
  """Do what the command line asks for; returns the exit code."""
  if traceback := words[:1] == ["--traceback"]:
    del words[0]
  if not words or words[0] in ("-h", "--help"):
    print(usage())
    return 0 if words else MISUSED
  known, name = commands(), words[0].replace("_", "-")
  name = ALIASES.get(name, name)
  if name not in known:
    near = difflib.get_close_matches(name, known, 1, 0.5)
    meant = f"did you mean {near[0]}?" if near else "`qcar-twin --help` lists them."
    print(f"qcar-twin: no command '{words[0]}'; {meant}", file=sys.stderr)
    return MISUSED
  # threads of a product of matrices wait for each other where processes of this program share the cores: over a
  # third of a diagnosis' processor time on two
  os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
  module = f"{__package__}.{name.replace('-', '_')}"
  return run(f"qcar-twin {name}", lambda: importlib.import_module(module), words[1:], traceback)


def main(arguments: Sequence[str] | None = None) -> int:
  """The command line; returns the exit code."""
  try:
    return dispatch(list(sys.argv[1:] if arguments is None else arguments))
  except BrokenPipeError:  # whoever read the output has gone, as `head` does
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


if __name__ == "__main__":
  raise SystemExit(main())
