"""A twin written for another tool, with what was lost in translation said and kept."""

from collections.abc import Collection
from pathlib import Path

from calibration.exports.loss import Loss, measure_loss
from calibration.exports.target import Job, target_named
from qcar_twin.atomic_io import write_json

_OF_MCAP = ("recordings", "diagnosis", "before", "after", "window", "log")
_OF_TWIN, _OF_VESC = ("twin",), ("pole_pairs", "vesc")


def refuse_idle(target: str, given: Collection[str]) -> None:
  """Raises ValueError where an option was given, by its name, that an export to a target has no use for."""
  idle = {"mcap": (*_OF_TWIN, *_OF_VESC), "vesc": _OF_MCAP}.get(target, (*_OF_MCAP, *_OF_VESC))
  for name in idle:
    if name in given:
      cure = "name the target with --to" if target == "mcap" else "leave it out"
      raise ValueError(f"an export to {target} takes no --{name.replace('_', '-')}: {cure}")


def is_a_file(out: Path) -> bool:
  """Whether a path is that of the file itself, and not of a folder for it."""
  return bool(out.suffix) and not out.is_dir()


def export_twin(name: str, job: Job, out: Path) -> tuple[Path, Loss | None]:
  """Write the file, print what to know and what was lost; the loss goes beside it as `<file>.loss.json`.

  Args:
    name: of the target; see `calibration.exports.target.targets`.
    out: the file, or a folder for a file of the usual name.

  Raises:
    KeyError: no such target.  ValueError: something a target needs is missing, with the option that gives it.
  """
  target = target_named(name)
  path = out if is_a_file(out) else out / target.file
  for sentence in target.write(job, path):
    print(sentence)
  loss = measure_loss(job, target, path)
  if loss is not None:
    print("\n".join(loss.lines()))
    write_json(path.with_name(f"{path.name}.loss.json"), {"target": name, **loss.document()})
  elif target.drives is not None:
    print("what was lost was not measured: that takes --dataset with recordings of role holdout or validate")
  print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")
  return path, loss
