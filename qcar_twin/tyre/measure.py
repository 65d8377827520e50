"""Microseconds per step with the tyre plugin and with native friction, in pairs: `python -m qcar_twin.tyre.measure`."""

import time

import mujoco

from qcar_twin.vehicle import TyreKind, Vehicle

MANOEUVRES = {"straight": (2.0, 0.0), "turn": (2.0, 0.2), "tight turn": (2.0, 0.3)}  # V, rad


def step_times(timestep: float = 0.002, rounds: int = 40, steps: int = 400) -> dict[str, dict[TyreKind, float]]:
  """Least time per step of interleaved runs in steady driving, manoeuvre -> tyre -> us.

  Args:
    timestep: s.  rounds: runs of each kind.  steps: per run.
  """
  kinds: tuple[TyreKind, ...] = ("contact", "native")
  best: dict[str, dict[TyreKind, float]] = {name: dict.fromkeys(kinds, float("inf")) for name in MANOEUVRES}
  cars = []
  for tyre in kinds:
    model = Vehicle.load().spec(tyre=tyre, timestep=timestep).compile()
    for name, command in MANOEUVRES.items():
      data = mujoco.MjData(model)
      data.ctrl[:] = command
      mujoco.mj_step(model, data, round(3.0 / timestep))
      cars.append((name, tyre, model, data))
  for _ in range(rounds):
    for name, tyre, model, data in cars:
      begin = time.perf_counter()
      mujoco.mj_step(model, data, steps)
      best[name][tyre] = min(best[name][tyre], 1e6 * (time.perf_counter() - begin) / steps)
  return best


if __name__ == "__main__":
  for timestep in (0.002, 0.005):
    for name, times in step_times(timestep).items():
      print(f"{1e3 * timestep:g} ms, {name:10s}  plugin {times['contact']:5.2f} us  native {times['native']:5.2f} us"
            f"  ratio {times['contact'] / times['native']:.2f}")  # fmt: skip
