"""The examples of docs/guide/extending.md, and a copy of the project to do them in."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests import ROOT

PAGE = ROOT / "docs" / "guide" / "extending.md"
_FILE = re.compile(r"^`(?P<path>[\w./]+)`\n```\w+\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
_PARTS = ("assets", "qcar_twin", "tests", "docs/reference/mechanisms.md", "docs/reference/tyre.md", "pyproject.toml")
_MADE = shutil.ignore_patterns("__pycache__")  # what is built is named after its sources: it serves the copy or is new


def files_of(section: str) -> dict[str, str]:
  """Files a section of the page shows, path -> text: each block below a line with nothing but a path."""
  text = PAGE.read_text(encoding="utf-8")
  body = text.split(f"\n## {section}\n", 1)[1].split("\n## ", 1)[0]
  files = {m["path"]: m["text"] for m in _FILE.finditer(body)}
  assert files, f"section '{section}' of {PAGE.name} shows no file"
  return files


class Copy:
  """A copy of the package and its tests.

  Attributes:
    folder: its root.
  """

  def __init__(self, folder: Path):
    self.folder = folder
    for part in _PARTS:
      source, target = ROOT / part, folder / part
      target.parent.mkdir(parents=True, exist_ok=True)
      if source.is_dir():
        shutil.copytree(source, target, ignore=_MADE)
      else:
        shutil.copy(source, target)
    self._before = self._hashes()

  def touched(self) -> set[str]:
    """Files that are new or other than at first, but for what was built."""
    return {path for path, mark in self._hashes().items() if self._before.get(path) != mark}

  def python(self, *arguments: str) -> str:
    """What the interpreter prints, run in the copy; `calibration` and `scripts` are the project's own."""
    environment = os.environ | {"PYTHONPATH": f"{self.folder}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=self.folder, env=environment, check=False)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout

  def tests(self, *arguments: str) -> int:
    """How many tests of the copy pass; none may fail."""
    said = self.python("-m", "pytest", "-p", "no:cacheprovider", "-c", "pyproject.toml", "-rN", *arguments)
    return int(re.findall(r"(\d+) passed", said)[-1])

  def _hashes(self) -> dict[str, str]:
    files = {p.relative_to(self.folder): p for p in self.folder.rglob("*") if p.is_file()}
    made = lambda path: any(part in ("__pycache__", "_build") or part.startswith(".") for part in path.parts)
    return {k.as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for k, p in files.items() if not made(k)}
