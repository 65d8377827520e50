"""How often effects of predicted sizes are claimed, on the linear car.

    python -m tests.calibration.diagnosis.search.detectable_rates 14

A car without an effect says from which size on each mechanism would be claimed. Other cars, with other noise, have it
at multiples of that size, are searched and decided.
"""

import sys
from collections.abc import Container, Iterator

from calibration.diagnosis.decision.decide import decide
from calibration.diagnosis.search.detectable import detectable
from calibration.diagnosis.search.gather import gather
from tests.calibration.diagnosis import diagnosis_rig as rig

NAMES = ("quadratic_drag", "side_force", "steering_offset")
MULTIPLES = (0.5, 0.71, 0.84, 1.19, 1.41, 2.0)


def rates(seeds: int, multiples: Container[float] = MULTIPLES) -> Iterator[tuple[str, float, bool]]:
  """(mechanism, multiple of its predicted size, whether it was claimed) case by case, for these of MULTIPLES."""
  for seed in range(seeds):
    clean = rig.session({}, seed=seed)
    smallest = detectable(clean, gather(clean))
    for name in NAMES:
      for place, multiple in enumerate(MULTIPLES):
        if multiple not in multiples:
          continue
        size = smallest[name].size
        assert size is not None, name
        truth = {smallest[name].parameter: multiple * size}
        claims = decide(gather(rig.session(truth, seed=1000 * (place + 1) + seed))).claims
        yield name, multiple, any(name in (c.mechanism, *c.indistinguishable_from) for c in claims)


if __name__ == "__main__":
  found = list(rates(int(sys.argv[1])))
  for multiple in MULTIPLES:
    hits = [hit for _, k, hit in found if k == multiple]
    print(f"{multiple:g} times the predicted size: claimed {sum(hits)} of {len(hits)}")
