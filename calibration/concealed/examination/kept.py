"""Cases with their evidence: found in folders and archives, and kept together in one archive that weights come from."""

import json
import lzma
from collections.abc import Iterable, Sequence
from pathlib import Path

from calibration.diagnosis.decision.evidence import as_json
from qcar_twin.atomic_io import whole_file

from ..campaign.archive import digest
from ..campaign.replay import Kept, kept_cases, read_results
from .sealed import PLAN, opened


def kept_in(sources: Iterable[Path]) -> list[Kept]:
  """Cases that kept their evidence, of campaigns' folders, archives and folders of closed exams.

  Raises:
    ValueError: no case did; an exam is not closed.
    UnreadableFile: an archive is damaged.
  """
  sources = list(sources)
  results = [r for s in sources for r in (opened(s) if (s / PLAN).is_file() else read_results(s))]
  cases = list(kept_cases(results))
  if not cases:
    said = ", ".join(map(str, sources))
    raise ValueError(f"{said}: no case kept its evidence; run the campaign again, as this version does")
  return cases


def write_kept(archive: Path, cases: Sequence[Kept]) -> None:
  """Write an archive that `kept_in` reads the same cases from; of an answer it has the evidence alone."""
  rows = []
  for case in cases:
    answer = {"evidence": as_json(case.evidence)}
    truth = [{"right": sorted(names)} for names in case.effects]
    told = {"name": case.name, "kind": case.kind, "car": case.generator}
    rows.append(json.dumps({"case": told, "answer": answer, "sha256": digest(answer), "truth": truth}))
  with whole_file(archive) as part:
    part.write_bytes(lzma.compress("\n".join(rows).encode(), preset=9))
