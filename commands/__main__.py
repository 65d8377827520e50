"""`qcar-twin COMMAND [options]`: lists the commands, runs one of them, says in a sentence what went wrong."""

import ast
import difflib
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from qcar_twin.cures import cure

USAGE = """usage: qcar-twin [--traceback] COMMAND [options]

{commands}

`qcar-twin COMMAND --help` lists the options with their units; with --traceback an error says where it arose."""
PACKAGES = ("qcar_twin", "calibration", "agents", "commands")
FAILED, MISUSED, INTERRUPTED = 1, 2, 130  # exit codes; the last is the shell's for Ctrl-C


def commands() -> dict[str, str]:
  """Name -> what the command does, the first line of its file's docstring; nothing is imported."""
  files = sorted(Path(__file__).parent.glob("[!_]*.py"))
  said = {path.stem: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" for path in files}
  return {stem.replace("_", "-"): text.partition("\n")[0] for stem, text in said.items()}


def usage() -> str:
  """The list of commands."""
  return USAGE.format(commands="\n".join(f"  {name:<26}{text}" for name, text in commands().items()))


def sentence(error: Exception) -> str | None:
  """What to tell the user, None where the error is none of the input but a fault of the program.

  Input: files, values, unknown names (a KeyError with a sentence), missing packages, errors of this project's kinds.
  """
  if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] not in PACKAGES:
    return f"this needs the package '{(error.name or '').partition('.')[0]}', which is not installed"
  if isinstance(error, KeyError) and error.args and " " in str(error.args[0]):
    return str(error.args[0])
  own = isinstance(error, ValueError) or type(error).__module__.partition(".")[0] in PACKAGES
  return cure(error) or (str(error) if own else None)


def run(name: str, arguments: Sequence[str], traceback: bool = False) -> int:
  """Run one command; returns the exit code.

  A command's module has `Config`, `main`, and, where a stopped run leaves anything, `KEPT`: what.
  """
  import tyro  # here, because the list of commands needs nothing but the standard library

  module: ModuleType | None = None
  logging.basicConfig(level=logging.WARNING, format="%(message)s")
  try:
    module = importlib.import_module(f"commands.{name.replace('-', '_')}")
    module.main(tyro.cli(module.Config, prog=f"qcar-twin {name}", description=module.__doc__, args=list(arguments)))
  except KeyboardInterrupt:
    kept = getattr(module, "KEPT", "nothing of this run is kept: results are written at its end")
    print(f"\nqcar-twin {name}: stopped; {kept}", file=sys.stderr)
    return INTERRUPTED
  except Exception as error:
    said = None if isinstance(error, BrokenPipeError) else sentence(error)
    if traceback or said is None:
      raise
    print(f"qcar-twin {name}: {said}", file=sys.stderr)
    return FAILED
  return 0


def dispatch(words: list[str]) -> int:
  """Do what the command line asks for; returns the exit code."""
  if traceback := words[:1] == ["--traceback"]:
    del words[0]
  if not words or words[0] in ("-h", "--help"):
    print(usage())
    return 0 if words else MISUSED
  known, name = commands(), words[0].replace("_", "-")
  if name not in known:
    near = difflib.get_close_matches(name, known, 1, 0.5)
    meant = f"did you mean {near[0]}?" if near else "`qcar-twin --help` lists them."
    print(f"qcar-twin: no command '{words[0]}'; {meant}", file=sys.stderr)
    return MISUSED
  return run(name, words[1:], traceback)


def main(arguments: Sequence[str] | None = None) -> int:
  """The command line; returns the exit code."""
  try:
    return dispatch(list(sys.argv[1:] if arguments is None else arguments))
  except BrokenPipeError:  # whoever read the output has gone, as `head` does
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


if __name__ == "__main__":
  raise SystemExit(main())
