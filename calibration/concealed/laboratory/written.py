"""A driven session and what is written of it: recordings, the vehicle table, the mark of its sealed truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from qcar_twin.atomic_io import whole_file
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording

from .manoeuvres import PERIOD, Manoeuvre


@dataclass(frozen=True)
class Session:
  """One laboratory session. `clean`: recording name -> the true signals (T, 11) in the order of the truth's `signals`.

  `source`: the package that drove it.
  """

  recordings: tuple[Recording, ...]
  vehicle: dict[str, float | str]
  vehicle_std: dict[str, float]
  truth: dict
  clean: dict[str, np.ndarray] = field(repr=False)
  source: str = "calibration/concealed/proving_ground"


def stream(seed: int, topic: int) -> np.random.Generator:
  """An independent stream of random numbers for each topic of a session, so that an effect does not move the others."""
  return np.random.default_rng([seed, topic])


def as_recording(
  run: Manoeuvre, columns: Mapping[str, np.ndarray], decimals: Mapping[str, int], every: Mapping[str, int]
) -> Recording:
  """One run as streams of its own sample times, rounded to what the log file holds; `every`: ticks between samples."""
  time = np.round(PERIOD * np.arange(run.ticks), 4)
  table = {}
  for name, values in columns.items():
    table[name] = np.round(values, decimals[name])
    if every.get(name, 1) > 1:
      table[name] = np.where(np.arange(run.ticks) % every[name] == 0, table[name], np.nan)
  return Recording.from_columns(
    run.name, time, table, file=f"{run.name}.csv", role=run.role, manoeuvre=run.kind, session=run.session
  )


def save_clean(session: Session, folder: Path) -> None:
  """Write the true signals of every run to folder/clean.npz, arrays (T, 11) in the order of the truth's `signals`."""
  with whole_file(folder / "clean.npz") as part:
    np.savez_compressed(part, allow_pickle=False, **session.clean)


def save(session: Session, folder: Path, name: str, mark: str) -> None:
  """Write the recordings and the vehicle table as a data set whose description publishes the commitment `mark`."""
  text = f"Laboratory session of the independent simulated car. Truth sealed, SHA-256 with salt: {mark}"
  rounded = {key: v if isinstance(v, str) else float(f"{v:.6g}") for key, v in session.vehicle.items()}
  std = {key: float(f"{value:.3g}") for key, value in session.vehicle_std.items()}
  write_dataset(folder, name, rounded, std, session.recordings, description=text, licence="MIT", source=session.source)
