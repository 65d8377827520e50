"""The fit of the weights to kept evidence: found again, every generator alike, judged where it was not fitted."""

import dataclasses
import shutil
import tomllib

import numpy as np
import pytest

from calibration.concealed.campaign.replay import Kept
from calibration.concealed.campaign.set_levels import (
  WEIGHTS,
  Stated,
  fitted_weights,
  held_out_weight,
  judged_apart,
  log_loss,
  stated,
  weighed,
  with_weights,
  write_weights,
)
from calibration.concealed.examination.kept import write_kept
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.evidence import Evidence, Model, Named
from calibration.diagnosis.decision.levels import FILE, read_levels, usual_levels
from scripts import set_levels
from tests import ROOT

LEVELS = usual_levels()
TRUTH = dict(zip(WEIGHTS, (-1.0, 0.7, 0.4), strict=True))


def case(t, nats, right=(), generator="first", names=1, at_bound=False):
  """A case in which several names alike were weighed: held-out t, and nats ahead of nothing."""
  test = Comparison(t, t, 1.0, (0.0,) * 8, 1.0, drop=nats)
  spread = dataclasses.replace(test, blocks=tuple(np.sqrt(7.0 / 8.0) * np.array([1.0, -1.0] * 4) / np.sqrt(8.0)))
  named = [Named(f"name_{k}", spread, at_bound, (), ()) for k in range(names)]
  models = (Model((), 0.0), *(Model((n.name,), nats, (n,)) for n in named))
  kind = "single" if right else "null"
  return Kept("case", kind, tuple(frozenset([r]) for r in right), Evidence("", models, ()), generator)


def drawn(weights, count=3000, seed=0, generator="first"):
  """Cases of one name each, right as often as weights say."""
  random, levels = np.random.default_rng(seed), with_weights(LEVELS, weights)
  made = []
  for _ in range(count):
    t, nats = random.uniform(-3.0, 6.0), random.normal(0.0, 60.0)
    there = random.random() < levels.probability(t, nats)
    made.append(case(t, nats, ["name_0"] if there else [], generator))
  return made


def test_figures_are_those_of_the_evidence():
  seen = weighed([case(2.0, 30.0, ["name_0"]), case(-1.0, 5.0, at_bound=True)], LEVELS)
  assert seen.figures == pytest.approx(np.array([[2.0, np.log1p(30.0 / LEVELS.near)]])) and seen.right.tolist() == [
    True
  ]


def test_weights_are_found_again():
  assert fitted_weights(drawn(TRUTH), LEVELS) == pytest.approx(TRUTH, abs=0.15)


def test_every_generator_counts_alike_and_in_it_every_case():
  cases = [case(2.0, 30.0, names=4), case(2.0, 30.0), case(1.0, 9.0, generator="second", names=3)]
  counts = weighed(cases, LEVELS).counts
  assert counts == pytest.approx([0.125] * 4 + [0.5] + [1.0 / 3.0] * 3)
  few, other = drawn(TRUTH, 100), drawn(TRUTH | {"constant": -3.0}, seed=1, generator="second")
  assert fitted_weights([*few, *few, *other], LEVELS) == pytest.approx(fitted_weights([*few, *other], LEVELS), abs=0.02)


def test_cases_that_tell_nothing_are_refused():
  with pytest.raises(ValueError, match="answer more cases"):
    fitted_weights([case(1.0, 3.0)], LEVELS)


def test_a_loss_is_that_of_the_probabilities():
  cases = [case(2.0, 30.0, ["name_0"]), case(1.0, 3.0)]
  right, wrong = LEVELS.probability(2.0, 30.0), LEVELS.probability(1.0, 3.0)
  assert log_loss(cases, LEVELS) == pytest.approx(-0.5 * (np.log(right) + np.log(1.0 - wrong)))


def test_a_generator_is_judged_by_weights_fitted_to_the_others():
  """Of the second car one name of forty is right, however good all are; weights of the others don't know."""
  asked = dataclasses.replace(LEVELS, gain=0.0)
  first, second = drawn(TRUTH, 400), [case(5.0, 200.0, ["name_0"] * (k == 0), "second") for k in range(40)]
  after = with_weights(asked, fitted_weights([*first, *second], asked))
  said = judged_apart([*first, *second], asked, after)
  rows = {
    line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ") for line in said.splitlines() if line[:2] == "| "
  }
  assert rows["second"][1] == "1 of 40"
  fitted, apart = map(float, rows["second"][3:])
  assert apart == pytest.approx(log_loss(second, with_weights(asked, fitted_weights(first, asked))), abs=1e-3)
  assert fitted < apart and "second: 40 cases" in said
  assert "nothing to leave out" in judged_apart(first, asked, after)


def test_weights_are_written_beside_the_other_levels_with_their_origin(tmp_path):
  file = tmp_path / "levels.toml"
  shutil.copy(FILE, file)
  write_weights(dict.fromkeys(WEIGHTS, 0.25), "some cases", "a command", file)
  written = read_levels(file)
  assert written == dataclasses.replace(LEVELS, **dict.fromkeys(WEIGHTS, 0.25))
  text = file.read_text()
  assert text.count('command = "a command"') == text.count('source = "some cases"') == len(WEIGHTS)
  file.write_text(text.replace("[margin]", "[lead]"))
  with pytest.raises(ValueError, match="no table"):
    write_weights(dict.fromkeys(WEIGHTS, 0.25), "some cases", "a command", file)


def test_what_is_written_is_fitted_to_the_archive_it_names(tmp_path, capsys):
  archive, out = tmp_path / "evidence.jsonl.xz", tmp_path / "levels.toml"
  write_kept(tmp_path / "first.jsonl.xz", drawn(TRUTH, 60))
  write_kept(tmp_path / "second.jsonl.xz", drawn(TRUTH, 60, seed=1, generator="second"))
  sources = (tmp_path / "first.jsonl.xz", tmp_path / "second.jsonl.xz")
  said = set_levels.main(set_levels.Config(out, sources, archive=archive))
  assert said.startswith("120 cases: constant ") and said in capsys.readouterr().out
  entry = tomllib.loads(out.read_text())["t"]
  assert entry["source"] == "logistic regression on 120 cases of first, second, every generator counted alike"
  assert entry["command"] == f"qcar-twin set-levels --answers {archive} --out levels.toml"
  set_levels.main(set_levels.Config(tmp_path / "again" / "levels.toml", (archive,)))
  assert (tmp_path / "again" / "levels.toml").read_text() == out.read_text()


def answer(probability, ratio, right=True, kind="single", name="steering_lag", **more):
  """An answered case with one claim, and what its twin does to the error on held-out recordings."""
  truth = [{"id": name if right else "battery_sag"}] if kind != "null" else []
  claims = [{"mechanism": name, "probability": probability}]
  fit = {"holdout": {"yaw_rate": {"before": 2.0, "after": 2.0 * ratio}}}
  return {"case": {"kind": kind}, "truth": truth, "answer": {"claims": claims, "fit": fit} | more}


def test_only_claims_tell_what_held_out_recordings_are_worth_where_these_were_not_asked():
  two = answer(0.9, 0.5)
  two["answer"]["claims"] *= 2
  asked = answer(0.9, 0.5, evidence={"opened": [{"mechanisms": ["steering_lag"], "ratios": []}]})
  rows = [answer(0.5, 1.0 - 1e-12), answer(0.9, 3.0, kind="null"), two, asked, answer(0.9, 0.5, kind="pair")]
  seen = stated([*rows, answer(0.9, 0.5, right=False)], LEVELS)
  assert seen.log_odds == pytest.approx([0.0, np.log(9.0), np.log(9.0)])
  assert seen.change == pytest.approx([0.0, -1.0, 1.0], abs=1e-9) and seen.right.tolist() == [True, False, False]


def test_what_held_out_recordings_are_worth_is_found_again():
  random = np.random.default_rng(3)
  odds, change = random.uniform(0.0, 3.0, 20_000), random.uniform(-1.0, 1.0, 20_000)
  right = random.random(len(odds)) < 1.0 / (1.0 + np.exp(-odds - 0.8 * change))
  assert held_out_weight(Stated(odds, change, right)) == pytest.approx(0.8, abs=0.1)
  with pytest.raises(ValueError, match="answer more cases"):
    held_out_weight(Stated(odds, change, np.ones(len(odds), dtype=bool)))
  with pytest.raises(ValueError, match="--stated"):
    set_levels.main(set_levels.Config(ROOT / "levels.toml"))


@pytest.mark.slow
def test_the_installed_levels_are_those_of_the_archive_they_name(tmp_path):
  """So that no number that decides is older or newer than what it is said to come from."""
  table = tomllib.loads(FILE.read_text())
  of = lambda level: table[level]["command"].split("--")[1].split()[1:]
  answers, said = (tuple(ROOT / part for part in of(level)) for level in ("constant", "held"))
  set_levels.main(set_levels.Config(tmp_path / "levels.toml", answers, said))
  assert dataclasses.astuple(read_levels(tmp_path / "levels.toml")) == dataclasses.astuple(LEVELS)
