"""What is ready of a diagnosis lies on disk while the rest runs: a run that is stopped leaves it.

    staged/recalibrated.toml   the recalibrated twin, once it is fitted
    staged/ranking.json        mechanisms so far, best first: as scanned, then refitted and with claims
    staged/evidence.json       what the decision rests on, once the search is over
    staged/report.html, diagnosis.json, twin.toml, ...
                               the whole diagnosis, while a formula is sought for what stays unexplained

The folder goes when the results stand. `--twin staged/recalibrated.toml` goes on from a stopped run: what was fitted is
then the first guess.
"""

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.decision.evidence import Evidence, write_evidence
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN
from calibration.diagnosis.report.page import write_diagnosis
from calibration.diagnosis.scan import Signature
from qcar_twin.atomic_io import write_json
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.twin import Twin

Rows = Sequence[tuple[str, float]]
FOLDER, RANKING, BASE = "staged", "ranking.json", "recalibrated.toml"


@dataclasses.dataclass(frozen=True)
class Staged:
  """A place for what is ready; None for none."""

  out: Path | None = None

  def base(self, twin: Twin, theta: NDArray[np.float64], command_shift: int) -> None:
    """The recalibrated twin stands; `command_shift`: control periods by which its commands act later than logged."""
    if self.out:
      for file in (self.out / FOLDER).glob("*"):  # of another twin: of a run that was stopped, or a search begun again
        if file.name != BASE:  # replaced below, and never missing: a run may go on from it
          file.unlink()
      save_twin(self.out / FOLDER / BASE, twin, theta, "recalibrated; the search is not over", command_shift)

  def scanned(self, signatures: Mapping[str, Signature]) -> None:
    """Every mechanism was switched on once."""
    ranked = sorted(((name, s.gain) for name, s in signatures.items()), key=lambda item: (-item[1], item[0]))
    self._ranking("scan", ranked, [])

  def weighed(self, evidence: Evidence, decision: Decision) -> None:
    """The search is over; what is left, and the held-out recordings, were not looked at yet."""
    self._ranking("search", decision.ranking, [(c.mechanism, c.probability) for c in decision.claims])
    if self.out:
      write_evidence(self.out / FOLDER, evidence)

  def concluded(self, outcome: Outcome) -> None:
    """The diagnosis stands but for a formula; its report, without a film."""
    if self.out:
      write_diagnosis(outcome, self.out / FOLDER, NOTHING_SHOWN)

  def end(self) -> None:
    """The results stand."""
    if self.out:
      shutil.rmtree(self.out / FOLDER, ignore_errors=True)

  def _ranking(self, stage: str, ranked: Rows, claims: Rows) -> None:
    if self.out:
      rows = [{"mechanism": name, "evidence_nats": nats} for name, nats in ranked]
      named = [{"mechanism": name, "probability": probability} for name, probability in claims]
      write_json(self.out / FOLDER / RANKING, {"stage": stage, "ranking": rows, "claims": named})


NOWHERE = Staged()
