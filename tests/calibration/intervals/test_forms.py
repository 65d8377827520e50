"""Form deviations: their file, and what they are shares of."""

import pytest

from calibration.intervals.forms import read_forms, size_of, usual_forms


def test_every_form_has_a_source_and_others_have_one(tmp_path):
  assert 0.0 < usual_forms()["others"] < 1.0
  for text in ("[mass]\nvalue = 0.1\nsource = 'x'\n", "[others]\nvalue = 0.1\n"):
    file = tmp_path / "forms.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=r"forms\.toml: every entry needs a source"):
      read_forms(file)


def test_a_form_is_a_share_of_what_it_is_an_error_of():
  assert size_of("kg", 3.0, 0.01, 0.04) == 3.0 and size_of("N", -3.0, 0.01, 0.04) == 3.0
  assert size_of("s", 0.002, 0.01, 0.04) == 0.01  # of the control period
  assert size_of("m", 0.0, 0.01, 0.04) == 0.04  # a distance from what was measured
