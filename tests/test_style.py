"""What a stranger reads is in plain words: help texts, README, guide, the strings of reports."""

import pytest

from tests import ROOT
from tests.style import Text, counts, named_found, paragraphs, sentences, texts

TEXTS = texts(ROOT)
HELP = [text for text in TEXTS if text.kind == "help"]


def test_there_is_something_to_read():
  kinds = [text.kind for text in TEXTS]
  assert kinds.count("help") > 200 and kinds.count("page") > 150 and kinds.count("report") > 60
  assert {"scripts/diagnose.py --plant", "README.md", "calibration/diagnosis/report/page.py"} <= {
    t.where for t in TEXTS
  }


def test_help_texts_are_sentences_with_a_unit():
  assert not [f"{text.where}: lacks {', '.join(text.unfinished)}: {text.text}" for text in HELP if text.unfinished]


def test_help_texts_are_short_and_in_plain_words():
  assert not [f"{text.where}: {text.banned + text.long}" for text in HELP if text.banned or text.long]


def test_pages_and_reports_are_in_plain_words_and_short_sentences():
  assert not counts(ROOT), "file: banned words, sentences over 30 words, help texts that lack something"


def test_nothing_is_named_found_outside_the_diagnosis():
  assert named_found(ROOT) == 0


def test_a_name_is_counted_wherever_it_stands(tmp_path):
  (tmp_path / "scripts").mkdir()
  code = "def f(found):\n  found.found = g(found=1)\n  return f'{found}', 'found'\n"
  (tmp_path / "scripts" / "any.py").write_text(code, encoding="utf-8")
  assert named_found(tmp_path) == 5


@pytest.mark.parametrize(
  ("text", "banned", "long", "lacks"),
  [
    (Text("help", "x", "Speed, m/s.", True), [], 0, []),
    (Text("help", "x", "of training"), [], 0, ["capital", "full stop"]),
    (Text("help", "x", "Reference speed.", True), [], 0, ["unit"]),
    (Text("page", "x", "It is told anew, lest a rival stays."), ["told", "anew", "lest", "rival"], 0, []),
    (Text("report", "x", "One. " + "word " * 30 + "end. Two."), [], 1, []),
    (Text("report", "x", "word " * 29 + "end."), [], 0, []),
  ],
)
def test_the_counts_count(text, banned, long, lacks):
  assert (text.banned, len(text.long), text.unfinished) == (banned, long, lacks)


def test_prose_is_read_without_code_tables_and_links():
  page = "# Title\n\nOne [link](a.md) and `some code`.\nTwo.\n\n| a | b |\n\n"
  page += "```sh\nlest\n```\n\n* first\n* second\n\n![x](y.png)"
  assert [" ".join(p.split()) for p in paragraphs(page)] == ["One link and code. Two.", "first", "second"]
  assert sentences("It takes 2.5 s. Then 3 s. (See `a`.) End") == ["It takes 2.5 s.", "Then 3 s.", "(See `a`.)", "End"]
