"""The tables of docs/guide/environment.md are those of the code."""

import dataclasses
import inspect
import re

import gymnasium
import pytest

from agents.learning import environments
from agents.learning.environments import ENV_ID, SI_ENV_ID, Options, make_env
from agents.learning.observation import OBSERVATIONS
from qcar_twin.envs.spaces import ERROR_SCALE, LIMIT
from qcar_twin.envs.task import Reward
from tests import ROOT

PAGE = (ROOT / "docs" / "guide" / "environment.md").read_text(encoding="utf-8")


def table(head):
  """Rows of the table whose first column is called so, cells of each."""
  lines = PAGE[PAGE.index(f"| {head} |") :].split("\n\n")[0].splitlines()
  return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines[2:]]


def test_spaces_and_starts_are_those_of_the_registered_environments():
  rows = {row[0]: row[1:] for row in table("environment")}
  for k, name in enumerate((ENV_ID, SI_ENV_ID)):
    env = make_env(**gymnasium.spec(name).kwargs, plant="bicycle", estimator="truth")
    for kind in ("action", "observation"):
      said = re.match(r"`([^`]+)`", rows[f"{kind} space"][k])
      assert said and said[1] == str(getattr(env, f"{kind}_space"))
  assert rows["import"][0] == f"`{environments.__name__}`"
  assert f"within {Options.start_offset:g} m and {Options.start_heading:g} rad" in rows["begins"][0]


@pytest.mark.parametrize("sight", list(OBSERVATIONS))
def test_every_number_seen_has_its_row_and_its_scale(sight):
  scales, seen = {}, OBSERVATIONS[sight]
  for place, _, times, bound in table("observation"):
    numbers, other = re.findall(r"\d+", place.split(" of ")[0]), re.search(r"of `(\w+)`", place)
    assert bound == f"±{LIMIT:g}"
    if other and other[1] != sight:
      continue
    rows = range(int(numbers[0]), int(numbers[-1]) + 1)
    values = [float(text) for text in times.split(", ")]
    scales |= {row: values[i % len(values)] for i, row in enumerate(rows)}
  expected = [*ERROR_SCALE, *seen.scale]
  assert [scales[row] for row in range(seen.size)] == expected


def test_every_option_has_its_row():
  named = {name for row in table("argument") for name in re.findall(r"`(\w+)`", row[0])}
  own = set(inspect.signature(make_env).parameters) - {"options"} | {"render_mode"}
  assert {f.name for f in dataclasses.fields(Options)} | own == named - {"make"}


def test_every_weight_of_the_reward_is_told_with_its_default():
  text = " ".join(" ".join(row) for row in table("term")).translate(str.maketrans("₁₂₃₄₅₆", "123456"))
  for field in dataclasses.fields(Reward):
    name = {"lost_penalty": "M", "near": "`near`", "aligned": "`aligned`"}.get(field.name, field.name)
    said = re.search(rf"{name}(?: = m\d)? (?:= )?([\d.]+)( mm)?", text)
    assert said and float(said[1]) * (1e-3 if said[2] else 1.0) == pytest.approx(field.default), field.name


def test_the_terms_are_those_in_info():
  env = make_env(plant="bicycle", estimator="truth")
  env.reset(seed=0)
  *_, info = env.step(env.action_space.sample())
  assert [row[0].strip("`") for row in table("term")] == list(info["reward_terms"])
