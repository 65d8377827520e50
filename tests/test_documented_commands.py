"""Every `qcar-twin …` line in README, docs and the commands' own docstrings: known, complete, its options there; the
cheap ones are run as they stand."""

import ast
import importlib.util
import json
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path

import pytest

from qcar_twin.command_line import parsed, refuse_renamed
from scripts.__main__ import commands, dispatch
from tests import ROOT

KNOWN = commands()
TOUR = ROOT / "docs" / "guide" / "tour.ipynb"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
CHEAP = ("make-session", "check", "unseal", "estimate", "track", "new", "export")  # run for real, with --quick
PREFIX = r"(?:\.venv/bin/)?qcar-twin"


@dataclass(frozen=True)
class Line:
  """A command as it is written. `whole`: it stands on a line of its own and has to be complete."""

  where: str
  text: str
  whole: bool

  @property
  def words(self) -> list[str]:
    """Without comment, line continuations and the brackets that mark what may be left out."""
    plain = re.sub(r"[\[\]]", " ", self.text.replace("\\\n", " "))
    return shlex.split(plain, comments=True)

  def __str__(self) -> str:
    return f"{self.where}: {self.text}"


def lines_of(page: Path) -> Iterator[Line]:
  """Commands of a page: in code blocks, in tables whose head names qcar-twin, and in backticks within the prose."""
  text, name = page.read_text(encoding="utf-8"), page.name
  fence = re.compile(r"^```.*?^```", re.M | re.S)
  blocks = [*fence.findall(text), *re.findall(r"(?m)^    .+$", fence.sub("", text))]
  for block in blocks:
    for match in re.finditer(rf"^\s*{PREFIX} ((?:[^\n]*\\\n)*[^\n]+)", block, re.M):
      yield Line(name, match[1], True)
  prose = fence.sub("", text)
  for table in re.findall(r"(?m)(?:^\|.*\n)+", prose):
    head, *rows = table.splitlines()
    if "qcar-twin" in head:
      yield from (Line(name, span, True) for row in rows[1:] for span in re.findall(r"`([^`]+)`", row))
  for span in re.findall(r"`([^`]+)`", prose):
    if (match := re.match(rf"{PREFIX}\s+([a-z][^\n]*(?:\n[^\n]+)*)", span)) and "..." not in span:
      yield Line(name, match[1].replace("\n", " "), False)


def notebook_lines() -> Iterator[Line]:
  """The shell's lines of the tour."""
  for cell in json.loads(TOUR.read_text(encoding="utf-8"))["cells"]:
    source = "".join(cell["source"])
    yield from (Line(TOUR.name, line, True) for line in re.findall(r"(?m)^!qcar-twin (.+?)(?: 2>.*)?$", source))


def docstring_lines() -> Iterator[Line]:
  """The lines that `qcar-twin NAME --help` shows to be copied."""
  for path in sorted((ROOT / "scripts").glob("[!_]*.py")):
    said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    yield from (Line(path.name, line, True) for line in re.findall(r"(?m)^qcar-twin (.+)$", said))


LINES = [*(line for page in PAGES for line in lines_of(page)), *notebook_lines(), *docstring_lines()]


def config_of(name: str) -> type:
  return importlib.import_module(f"scripts.{name.replace('-', '_')}").Config


def completed(config: type, words: list[str]) -> list[str]:
  """With what has to be given and is not, for a command that prose names by the options it is about."""
  needed = [f.name for f in fields(config) if f.default is MISSING and f.default_factory is MISSING]
  absent = [name for name in needed if f"--{name.replace('_', '-')}" not in words]
  return words + [word for name in absent for word in (f"--{name.replace('_', '-')}", "x")]


def test_the_pages_have_lines_to_check():
  assert len(LINES) > 60 and sum(line.whole for line in LINES) > 40
  assert {line.where for line in LINES} >= {
    "README.md",
    "check.md",
    "learning.md",
    "estimation.md",
    "logs.md",
    "tour.ipynb",
  }
  listed = [line for line in LINES if line.where == "README.md"]
  assert {line.words[0] for line in listed} >= {"make-session", "diagnose", "train", "evaluate", "campaign"}


def test_every_command_is_documented():
  assert {line.words[0] for line in LINES} == set(KNOWN)


@pytest.mark.parametrize("line", LINES, ids=str)
def test_a_documented_command_is_one_and_its_options_exist(line, capsys):
  name, *words = line.words
  assert name in KNOWN, f"{line}: no such command"
  if not words and not line.whole:
    return  # prose that names the command
  config = config_of(name)
  words = words if line.whole else completed(config, words)
  refuse_renamed(config, words)
  try:
    parsed(config, words, name)
  except SystemExit:
    pytest.fail(f"{line}\n{capsys.readouterr().err}")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_line_for_a_shell_is_one_that_is_tried(page):
  """A command of ours, a target of make, a script or module that is there."""
  for block in re.findall(r"(?ms)^```sh\n(.*?)^```", page.read_text(encoding="utf-8")):
    for line in filter(None, re.sub(r"\\\n", " ", block).splitlines()):
      python = re.match(r"(?:\.venv/bin/)?python (?:-m ([\w.]+)|(\S+\.py))", line)
      if python:
        there = ROOT / (python[2] or python[1].replace(".", "/"))
        assert there.exists() or there.with_suffix(".py").exists() or importlib.util.find_spec(python[1]), line
      else:
        assert re.match(rf"{PREFIX} |make |#", line), f"{page.name}: nothing tries '{line}'"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_make_is_asked_for_is_a_target(page):
  targets = set(re.findall(r"(?m)^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8")))
  text = page.read_text(encoding="utf-8")
  asked = re.findall(r"(?m)^make ([a-z]+)", text) + re.findall(r"`make ([a-z]+)`", text)
  assert set(asked) <= targets


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
  """A folder as README finds it: data/ and logs/ beside out/, in which its own session has been made."""
  folder = tmp_path_factory.mktemp("desk")
  (folder / "data").symlink_to(ROOT / "data")
  with pytest.MonkeyPatch.context() as patch:
    patch.chdir(folder)
    (made,) = [line for line in LINES if line.where == "README.md" and line.words[0] == "make-session"]
    assert dispatch([*made.words, "--quick"]) == 0
  (folder / "logs").mkdir()
  for log in sorted((folder / "out" / "session").glob("*.csv"))[:3]:
    shutil.copy(log, folder / "logs")
  return folder


def _inputs(words: list[str]) -> list[str]:
  """Paths that a command reads."""
  return [value for option, value in zip(words, words[1:], strict=False) if "/" in value and not option.endswith("out")]


CHEAP_LINES = {
  tuple(line.words): line
  for line in LINES
  if line.where.endswith(".md") and line.whole and line.words[0] in CHEAP and not {"DIR", "NAME"} & set(line.words)
}


MAKERS = {line.words[1]: line for line in CHEAP_LINES.values() if line.words[0] == "new"}  # folder -> what makes it


@pytest.mark.slow
@pytest.mark.parametrize("line", CHEAP_LINES.values(), ids=str)
def test_a_cheap_command_runs_as_it_stands(line, desk, monkeypatch, capsys):
  monkeypatch.chdir(desk)
  words = line.words
  if words[0] == "make-session":
    assert (desk / "out" / "session" / "dataset.toml").is_file()
    return
  for folder in [word for word in words if word in MAKERS and not Path(word).exists()]:
    assert dispatch(MAKERS[folder].words) == 0, capsys.readouterr().err
  if words[0] == "new":  # run just now, or for a command that reads what it makes
    assert (desk / words[1] / "dataset.toml").is_file()
    return
  absent = [path for path in _inputs(words) if not Path(path).exists()]
  if absent:
    pytest.skip(f"reads {', '.join(absent)}, which a long command makes")
  quick = ["--quick"] if "quick" in {field.name for field in fields(config_of(words[0]))} else []
  assert dispatch([*words, *quick]) == 0, capsys.readouterr().err
