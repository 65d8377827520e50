"""Counts what is hard to read in what a stranger reads: `python -m tests.style [FOLDER]`, this checkout by default.

Help texts of the commands, README, the guide and the strings of reports: words of this project's own, sentences over 30
words, help texts without a capital, a full stop or a unit. Of the code, how often a value is named `found`.
"""

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests import ROOT

LONGEST = 30  # words of a sentence
BANNED = re.compile(
  r"\b(lest|anew|told|borne out|beside|likewise|wary|kept aside|left over|what is left|promise[ds]?|stretched|weighing"
  r"|leftovers?|passports?|trifles?|rivals?|names right)\b",
  re.IGNORECASE,
)
UNIT = re.compile(r"(, |\b)(s|min|m|kg|m/s|rad|deg|Hz|1/rad|pixels|dimensionless|multiples|factor|share)\b")
CODE = ("qcar_twin", "calibration", "agents", "scripts", "commands")
REPORTS = (
  "report",
  "page",
  "wording",
  "cars_page",
  "shapes",
  "figures",
  "further",
  "grounds",
  "demonstration",
  "study",
)
# pages of the guide in a checkout whose docs had no folders
FLAT_GUIDE = (
  "check",
  "curves",
  "characterise",
  "diagnosis",
  "estimation",
  "extending",
  "extending_channel",
  "learning",
)
FLAT_GUIDE += ("learning", "logs", "onboard", "recordings", "report", "sessions_and_cars")


@dataclass(frozen=True)
class Text:
  """A piece of what a stranger reads. `where` is its file, and the option it explains."""

  kind: str  # help, page, report
  where: str
  text: str
  needs_unit: bool = False

  @property
  def banned(self) -> list[str]:
    return [word.lower() for word in BANNED.findall(self.text)]

  @property
  def long(self) -> list[str]:
    return [sentence for sentence in sentences(self.text) if len(words(sentence)) > LONGEST]

  @property
  def unfinished(self) -> list[str]:
    """What a help text lacks."""
    if self.kind != "help":
      return []
    lacks = [] if self.text[:1].isupper() or self.text[:1] in "'\"" else ["capital"]
    lacks += [] if self.text.rstrip().endswith(".") else ["full stop"]
    return lacks + (["unit"] if self.needs_unit and not UNIT.search(self.text) else [])


def words(sentence: str) -> list[str]:
  """What holds a letter between spaces."""
  return [word for word in sentence.split() if re.search(r"[^\W\d_]", word)]


def sentences(text: str) -> list[str]:
  """A paragraph's sentences; an abbreviation or a number does not end one."""
  return re.split(r"(?:(?<=[a-z0-9)`\"'%*][.!?])|(?<=[.!?]\)))\s+(?=[A-Z`\"'(*<])", " ".join(text.split()))


def paragraphs(markdown: str) -> Iterator[str]:
  """Prose of a page: no code, tables, headings and pictures; every item of a list by itself."""
  text = re.sub(r"(?ms)^```.*?^```", "\n", markdown)
  text = re.sub(r"!\[[^]]*\]\([^)]*\)", "", text)
  text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
  text = re.sub(r"`[^`]*`", "code", text)
  text = re.sub(r"(?m)^(\s*)([*+-]|\d+\.)\s+", r"\n\1", text)
  for block in re.split(r"\n\s*\n", text):
    lines = [line for line in block.splitlines() if not re.match(r"\s*(\||#|<)|    ", line)]
    if lines:
      yield " ".join(lines)


def config_of(tree: ast.Module) -> ast.ClassDef | None:
  return next((n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "Config"), None)


def options(config: ast.ClassDef) -> Iterator[tuple[str, str, bool]]:
  """Name, text and whether it is a number with a unit, of every option; an option without a text has none."""
  for item, following in zip(config.body, [*config.body[1:], None], strict=True):
    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
      said = following.value if isinstance(following, ast.Expr) else None
      text = said.value if isinstance(said, ast.Constant) and isinstance(said.value, str) else ""
      yield item.target.id, " ".join(text.split()), "float" in ast.unparse(item.annotation)


def helps(root: Path) -> Iterator[Text]:
  """Of every command: its first lines, its Config's docstring, its options."""
  for path in sorted(p for room in ("scripts", "commands") for p in (root / room).glob("[!_]*.py")):
    tree, where = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(root).as_posix()
    config = config_of(tree)
    head = [paragraph for paragraph in (ast.get_docstring(tree) or "").split("\n\n") if "qcar-twin " not in paragraph]
    yield from (Text("help", where, " ".join(paragraph.split())) for paragraph in head)
    for name, text, number in options(config) if config else ():
      yield Text("help", f"{where} --{name.replace('_', '-')}", text, number)


def pages(root: Path) -> Iterator[Text]:
  """README and the guide."""
  guide = sorted((root / "docs" / "guide").glob("*.md")) or [root / "docs" / f"{name}.md" for name in FLAT_GUIDE]
  files = [root / "README.md", *guide]
  for path in (path for path in files if path.is_file()):
    where = path.relative_to(root).as_posix()
    yield from (Text("page", where, text) for text in paragraphs(path.read_text(encoding="utf-8")))


def literals(tree: ast.AST) -> Iterator[str]:
  """Strings of a module, without docstrings; what a formatted string puts in is one word."""
  inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
  documentation = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)}
  for node in ast.walk(tree):
    if isinstance(node, ast.JoinedStr):
      parts = [v.value if isinstance(v, ast.Constant) else "x" for v in node.values]
      yield "".join(str(part) for part in parts)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not {id(node)} & (inside | documentation):
      yield node.value


def reports(root: Path) -> Iterator[Text]:
  """Sentences that modules of reports write."""
  for path in sorted(p for room in CODE for p in (root / room).rglob("*.py")):
    if path.stem in REPORTS or path.stem.endswith("_report") or path.parent.name in ("report", "reports"):
      if path.parent.name in ("scripts", "commands"):
        continue
      where = path.relative_to(root).as_posix()
      for text in literals(ast.parse(path.read_text(encoding="utf-8"))):
        if len(words(text)) > 3:
          yield Text("report", where, re.sub(r"<[^>]*>", " ", text))


def named_found(root: Path) -> int:
  """How often a value is named `found`, outside the diagnosis."""
  count = 0
  for path in (p for room in CODE for p in (root / room).rglob("*.py")):
    if not {"diagnosis", "characterise"} & set(path.relative_to(root).parts):
      nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
      # of a name, an attribute, an argument or keyword, a function or class
      names = (getattr(node, field, None) for node in nodes for field in ("id", "attr", "arg", "name"))
      count += sum(name == "found" for name in names)
  return count


def texts(root: Path = ROOT) -> list[Text]:
  return [*helps(root), *pages(root), *reports(root)]


def counts(root: Path = ROOT) -> dict[str, tuple[int, int, int]]:
  """File -> words banned, sentences too long, what help texts lack; files without any are left out."""
  table: dict[str, tuple[int, int, int]] = {}
  for text in texts(root):
    before = table.get(file := text.where.split()[0], (0, 0, 0))
    more = (len(text.banned), len(text.long), len(text.unfinished))
    table[file] = (before[0] + more[0], before[1] + more[1], before[2] + more[2])
  return {file: row for file, row in sorted(table.items()) if any(row)}


def main(root: Path) -> None:
  """Print the counts of every file, of every kind and of the whole."""
  print(f"{'':60s}{'banned':>8s}{'long':>8s}{'lacks':>8s}")
  for file, row in counts(root).items():
    print(f"{file:60s}" + "".join(f"{n:8d}" for n in row))
  for kind in ("help", "page", "report"):
    of = [text for text in texts(root) if text.kind == kind]
    totals = (sum(len(getattr(text, what)) for text in of) for what in ("banned", "long", "unfinished"))
    print(f"all of {kind:53s}" + "".join(f"{n:8d}" for n in totals))
  print(f"values named `found` outside the diagnosis: {named_found(root)}")


if __name__ == "__main__":
  main(Path(sys.argv[1]) if sys.argv[1:] else ROOT)
