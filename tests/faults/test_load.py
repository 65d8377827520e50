"""A data set that is cut into many recordings is the same driving."""

import pytest

from qcar_twin.recordings.dataset import DataSet
from tests.faults.load import SHORTEST, cut
from tests.scripts.tiny_session import write


def test_pieces_are_the_driving_they_were_cut_from(tmp_path):
  write(tmp_path)
  whole = DataSet.load(tmp_path)
  count, driven = cut(tmp_path, 1.5)
  pieces = DataSet.load(tmp_path)
  assert len(pieces.recordings) == count > len(whole.recordings)
  length = lambda dataset: sum(r.duration for r in dataset.recordings)
  assert length(whole) == pytest.approx(driven, abs=0.02 * len(whole.recordings))
  assert length(pieces) == pytest.approx(driven, abs=0.02 * count)
  assert all(SHORTEST - 0.02 <= r.duration <= 1.5 + SHORTEST + 0.02 for r in pieces.recordings)
  roles = {r.name.rpartition("_")[0]: r.role for r in pieces.recordings}
  assert roles == {r.name: r.role for r in whole.recordings}
