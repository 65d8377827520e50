"""The order of the suite."""


def pytest_collection_modifyitems(items):
  """Files with a slow test first: workers that take whole files then end at about the same time."""
  slow = {item.path for item in items if item.get_closest_marker("slow")}
  items.sort(key=lambda item: item.path not in slow)
