"""Sizes of a checkout: `python -m tests.house [FOLDER]`, this one by default."""

import ast
import statistics
import sys
from pathlib import Path

from tests import ROOT

GROUPS = {"code": ("qcar_twin", "calibration", "agents", "scripts"), "tests": ("tests",)}


def sizes(files: list[Path]) -> dict[str, float]:
  """Files that hold anything, their lines, and how long files and functions are."""
  texts = [text for path in files if (text := path.read_text(encoding="utf-8"))]
  kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
  functions = [node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, kinds)]
  lines, lengths = [t.count("\n") for t in texts], [(f.end_lineno or f.lineno) - f.lineno + 1 for f in functions]
  return {
    "files": len(texts),
    "lines": sum(lines),
    "median file": statistics.median(lines),
    "longest file": max(lines),
    "median function": statistics.median(lengths),
    "longest function": max(lengths),
  }


def main(root: Path = ROOT) -> None:
  """Print them for code and tests, and the folder with the most files."""
  for group, packages in GROUPS.items():
    files = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    print(f"{group}: " + ", ".join(f"{name} {value:g}" for name, value in sizes(files).items()))
    fullest = max({p.parent for p in files}, key=lambda folder: len(list(folder.glob("*.py"))))
    print(f"  most files in a folder: {len(list(fullest.glob('*.py')))}, {fullest.relative_to(root).as_posix()}")


if __name__ == "__main__":
  main(Path(sys.argv[1]) if sys.argv[1:] else ROOT)
