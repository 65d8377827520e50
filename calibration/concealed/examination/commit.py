"""Which state of the code sits an exam: its commit, and whether anything differs from it."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


class NotCommitted(RuntimeError):
  """The code is not a commit's, so that nobody could tell what sat the exam."""


def committed(root: Path = ROOT) -> str:
  """The commit that is checked out, 40 digits.

  Raises:
    NotCommitted: files differ from it, or this is no checkout of git.
  """
  changed = _git(root, "status", "--porcelain")
  if changed:
    raise NotCommitted(
      f"{changed.splitlines()[0].strip()!r} and {len(changed.splitlines()) - 1} others differ from the commit: commit"
      " first, or say --unsealed for a trial"
    )
  return _git(root, "rev-parse", "HEAD")


def code_of(root: Path = ROOT) -> str:
  """What a trial is sat with, in words: the commit, and whether files differ from it; "" where git knows nothing."""
  try:
    commit, changed = _git(root, "rev-parse", "HEAD"), _git(root, "status", "--porcelain")
  except NotCommitted:
    return ""
  return commit[:12] + (" with changed files" if changed else "")


def _git(root: Path, *words: str) -> str:
  try:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
  except (OSError, subprocess.CalledProcessError) as error:
    raise NotCommitted(f"{root} is no checkout of git: clone the repository, or say --unsealed for a trial") from error
  return done.stdout.strip()
