"""The order of the suite, and what no test may leave behind."""

import pytest

from qcar_twin.twin import mechanisms


def pytest_collection_modifyitems(items):
  """Files with a slow test first: workers that take whole files then end at about the same time."""
  slow = {item.path for item in items if item.get_closest_marker("slow")}
  items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(autouse=True)
def added_mechanisms_go_with_their_test(monkeypatch):
  """A file added stays for the life of a process: the next test of the same worker would find one mechanism more."""
  monkeypatch.setattr(mechanisms, "_added", list(mechanisms._added))
