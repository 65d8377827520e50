"""Every ```python block of README: its imports exist, and its calls of imported functions fit their signatures.

That blocks run is tested by test_documented_blocks.py. The page of the interface is that of today.
"""

import ast
import inspect
import re
from importlib import import_module
from typing import Any

import pytest

from docs.make import api, parameters
from tests import ROOT

BLOCKS = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)


def imported(tree: ast.Module) -> dict[str, Any]:
  """What a block imports, by the name it uses."""
  froms = (node for node in tree.body if isinstance(node, ast.ImportFrom))
  return {a.asname or a.name: getattr(import_module(str(f.module)), a.name) for f in froms for a in f.names}


def test_readme_has_an_example_in_python():
  assert BLOCKS


@pytest.mark.parametrize("block", BLOCKS)
def test_calls_of_an_example_fit_the_signatures(block: str):
  tree = ast.parse(block)
  names = imported(tree)
  calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id in names]
  assert calls or not names
  for call in calls:
    keywords = {word.arg: None for word in call.keywords if word.arg}
    inspect.signature(names[ast.unparse(call.func)]).bind(*([None] * len(call.args)), **keywords)


def test_the_page_of_the_interface_has_the_names_and_signatures_of_today():
  text = api.PAGE.read_text(encoding="utf-8")
  for _, module, name in api.names():
    head = api.signature(getattr(import_module(module), name))
    assert f"### {name}\n\n`from {module} import {name}`\n\n```text\n{head}\n```" in text, f"{name}: run make docs"


def test_the_page_of_parameters_is_their_table():
  page = ROOT / "docs" / "reference" / "parameters.md"
  assert page.read_text(encoding="utf-8") == parameters.page(), (
    "run python -m docs.make.parameters > docs/reference/parameters.md"
  )
