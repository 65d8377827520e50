"""The table of consistency by block: within its band where covariances are those of the errors, and only there."""

import numpy as np

from agents.studies.filtering.consistency import BLOCKS, band, block_nees, consistency_table


def drawn(scale, seed, instants=2000, cars=8):
  """Normalised squared errors of a filter whose errors are `scale` times what it states."""
  rng = np.random.default_rng(seed)
  variances = np.array([1e-4, 4e-4, 9e-4, 1e-2])
  errors = scale * np.sqrt(variances) * rng.standard_normal((instants, cars, 4))
  position = scale**2 * np.square(rng.standard_normal((instants, cars, 2))).sum(axis=-1)
  return block_nees(position, errors, variances)


def test_a_consistent_filter_is_within_its_band_and_one_that_believes_too_much_is_not():
  honest, boasting = ([drawn(scale, seed)[: 2000 - seed] for seed in range(3)] for scale in (1.0, 1.5))
  table = consistency_table({("plain", "N"): honest, ("plain", "MIS"): boasting})
  rows = [[cell.strip() for cell in line.split("|")[3:-1]] for line in table[-2:]]
  for cells, expected, share in zip(rows, (1.0, 2.25), ((93, 97), (0, 40)), strict=True):
    for cell, states in zip(cells, BLOCKS.values(), strict=True):
      mean, inside = float(cell.split(" (")[0]), int(cell.split("(")[1].split(" ")[0])
      assert abs(mean - expected * states) < 0.1 * states and share[0] <= inside <= share[1]
  assert "24 cars" in table[0] and "position [1.28, 2.88]" in table[2]


def test_the_band_holds_the_mean_of_many_cars():
  """Two states of 24 cars: chi-square with 48 degrees of freedom over 24, by its table."""
  assert np.allclose(band(2, 24), (30.755 / 24, 69.023 / 24), atol=1e-3)
