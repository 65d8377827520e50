"""Levels and their sources."""

import pytest

from calibration.likelihood.levels import FILE, levels


def test_all_levels_have_a_source():
  assert 0.0 < levels().family_wise < 0.1


def test_at_most_twelve_numbers_decide():
  assert FILE.read_text(encoding="utf-8").count("\nvalue =") <= 12


def test_a_level_without_a_source_is_refused(tmp_path):
  bad = tmp_path / "levels.toml"
  bad.write_text(FILE.read_text(encoding="utf-8").replace('source = "stated error rate', 'source = ""\nwas = "'))
  with pytest.raises(ValueError, match="family_wise.*no source"):
    levels(bad)


def test_an_unknown_level_is_refused(tmp_path):
  bad = tmp_path / "levels.toml"
  bad.write_text(FILE.read_text(encoding="utf-8") + '\n[another]\nvalue = 1.0\nsource = "none"\n')
  with pytest.raises(ValueError, match="another"):
    levels(bad)
