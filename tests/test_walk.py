"""The code tour in the documents follows the code as it is: its folders, the functions called, their order."""

import ast
import functools
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests import ROOT

PAGE = (ROOT / "docs" / "reference" / "walk.md").read_text(encoding="utf-8")
INTRODUCTION, *SECTIONS = re.split(r"^## \d+\. ", PAGE, flags=re.M)
STATION = re.compile(r"`([\w/]+\.py):([\w.]+)`")
MOST_ROOMS, MOST_LINES = 10, 75  # a page
ROOMS = [re.match(r"`([\w/]+/)`", section).group(1) for section in SECTIONS]
CORRIDOR = STATION.findall(INTRODUCTION)
STATIONS = [STATION.findall(section) for section in SECTIONS]
NAMED = [*CORRIDOR, *(station for stations in STATIONS for station in stations)]
Place = tuple[str, str]  # file, name in it


def module_of(file: str) -> ModuleType:
  return import_module(file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"))


def room_of(file: str) -> str:
  """The innermost of the walk's rooms that a file lies in."""
  return max((room for room in ROOMS if file.startswith(room)), key=len)


def place_of(thing: Any) -> Place | None:
  """Where a function or class is defined; None for what is not of this project."""
  file = getattr(sys.modules.get(getattr(thing, "__module__", None) or ""), "__file__", None)
  if file is None or not Path(file).is_relative_to(ROOT) or not hasattr(thing, "__qualname__"):
    return None
  return Path(file).relative_to(ROOT).as_posix(), thing.__qualname__


class Calls(ast.NodeVisitor):
  """Dotted names that a piece of code calls, in the order in which they are run: arguments before the call."""

  def __init__(self) -> None:
    self.names: list[str] = []

  def visit_Call(self, node: ast.Call) -> None:
    self.generic_visit(node)
    self.names.append(ast.unparse(node.func))


@functools.cache
def called(place: Place) -> tuple[Place, ...]:
  """What a function of this project calls by a name that its file knows, in order."""
  file, name = place
  module, calls = module_of(file), Calls()
  for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name == name.split(".")[-1]:
      calls.visit(node)
  things = (_thing(module, dotted) for dotted in calls.names)
  return tuple(p for thing in things if thing is not None and (p := place_of(thing)))


def _thing(module: ModuleType, dotted: str) -> Any:
  if not re.fullmatch(r"[\w.]+", dotted):
    return None
  return functools.reduce(lambda thing, part: getattr(thing, part, None), dotted.split("."), module)


def walk(place: Place, seen: set[Place]) -> Iterator[Place]:
  """What is met from a function on: through its own folder, and through the stations of the walk alone."""
  if place in seen:
    return
  seen.add(place)
  yield place
  for other in called(place):
    if other in NAMED or Path(other[0]).parent == Path(place[0]).parent:
      yield from walk(other, seen)


MET = [place for place in walk(CORRIDOR[0], set()) if place in NAMED]


def test_the_page_is_one_page_of_ten_rooms_at_most():
  assert PAGE.count("\n") <= MOST_LINES
  assert max(map(len, PAGE.splitlines())) <= 130
  assert 0 < len(ROOMS) <= MOST_ROOMS
  assert PAGE.startswith("# Code tour\n\nFrom `DataSet.load` to a claim in `diagnosis.json`")


def test_every_room_is_a_folder_and_entered_once():
  assert len(set(ROOMS)) == len(ROOMS)
  assert all((ROOT / room).is_dir() for room in ROOMS)


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_what_it_names_exists(file: str, name: str):
  assert place_of(_thing(module_of(file), name)) == (file, name)


def test_what_a_section_names_lies_in_its_room():
  for room, stations in zip(ROOMS, STATIONS, strict=True):
    assert stations, room
    assert {room_of(file) for file, _ in stations} == {room}


def test_every_door_is_on_the_way():
  assert set(MET) == set(NAMED)


def test_rooms_are_entered_in_the_order_of_the_calls():
  entered = list(dict.fromkeys(room_of(file) for file, name in MET if (file, name) not in CORRIDOR))
  assert entered == ROOMS


@pytest.mark.parametrize("number", range(len(ROOMS)))
def test_doors_of_a_room_are_passed_in_the_order_of_the_page(number: int):
  passed = [MET.index(station) for station in STATIONS[number]]
  assert passed == sorted(passed)
