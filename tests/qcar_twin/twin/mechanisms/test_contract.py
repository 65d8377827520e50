"""What every mechanism of the catalogue promises, checked on made-up motion."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from qcar_twin.plant import Driving
from qcar_twin.twin import mechanisms
from qcar_twin.twin.mechanisms import catalogue, select
from qcar_twin.twin.mechanisms.base import Mechanism, describe
from qcar_twin.twin.mechanisms.document import sections
from qcar_twin.twin.suited import sought
from tests.counting import calls
from tests.qcar_twin.twin.mechanisms.mechanism_bench import (
  CAR,
  BenchModel,
  drive,
  mirror_results,
  run,
  stacked,
  still,
  theta_of,
)

SHARED = {"__init__", "base", "by_motion", "elements", "document"}  # files of the folder that define no mechanism
ALL = list(catalogue().values())
STATED = {f.name: 1e-4 for f in dataclasses.fields(CAR)}  # standard deviations
each = pytest.mark.parametrize("mechanism", ALL, ids=lambda m: m.name)


def test_every_file_of_the_folder_is_in_the_catalogue():
  files = {path.stem for path in Path(str(mechanisms.__file__)).parent.glob("*.py")}
  assert sorted(catalogue()) == sorted(files - SHARED)


def test_unknown_name_is_answered_with_the_nearest():
  with pytest.raises(KeyError, match="steering_delay"):
    select(["steering_delays"])
  assert [m.name for m in select(["cogging", "payload"])] == ["cogging", "payload"]


@each
def test_file_has_the_name_of_its_mechanism(mechanism):
  assert type(mechanism).__module__.rsplit(".", 1)[1] == mechanism.name
  assert type(mechanism).__name__.lower() == mechanism.name.replace("_", "")


@each
def test_docstring_tells_equation_units_source_and_rivals(mechanism):
  text = type(mechanism).__doc__
  sections = re.findall(r"^  (Equation|Units|Source|Size|Confounded with): (.+)", text, re.MULTILINE)
  assert [title for title, _ in sections] == ["Equation", "Units", "Source", "Size", "Confounded with"]
  body = dict(sections)
  equation = text.split("Equation:")[1].split("Units:")[0]
  assert re.search(r"=|->|<=", equation)
  assert re.search(r"\b(19|20)\d\d\b", text.split("Source:")[1].split("Size:")[0])
  assert len(body["Confounded with"]) > 10
  assert text.splitlines()[0].rstrip().endswith(".")
  assert describe(mechanism)["summary"] == text.splitlines()[0]


@each
def test_every_typical_size_has_a_source_or_is_a_stated_prior(mechanism):
  text = sections(mechanism)["Size"]
  owned = "stated prior: " in text or re.search(r"\b(19|20)\d\d\b|data sheet|sec\. ", text)
  assert owned and text.endswith(".")
  for size in {f"{p.typical:g}" for p in mechanism.parameters if p.typical is not None}:
    assert re.search(rf"(?<![\d.]){re.escape(size)}(?![\d]|\.\d)", text), f"{size} is not explained: {text}"


@each
def test_parameters_declare_null_and_size(mechanism):
  amplitude, *others = mechanism.parameters
  assert amplitude.null == amplitude.nominal == 0.0
  for p in (amplitude, *(p for p in others if p.null is not None)):
    assert p.typical is not None and p.typical > 0 and p.nominal == p.null
    assert p.null + 1.5 * p.typical <= p.upper
    assert mechanism.signed == (p.lower < p.null)
  for p in others:
    assert p.lower < p.upper
    assert (p.null is None) == (p.typical is None)
  assert all(p.description for p in mechanism.parameters)


@each
def test_search_starts_are_shapes_inside_their_bounds(mechanism):
  shapes = {p.name: p for p in mechanism.parameters if p.null is None}
  places = np.random.default_rng(0).normal(0.0, 2.0, (500, 2))
  starts = [s for xy in (places, places[:0]) for s in mechanism.initial_guesses(Driving(5.0, 700.0, xy))]
  assert len(starts) >= 2
  for start in starts:
    assert set(start) <= set(shapes)
    assert all(shapes[k].lower <= v <= shapes[k].upper for k, v in start.items())


@each
def test_what_every_model_fits_is_a_small_amplitude_of_its_own_and_perhaps_its_shape(mechanism):
  mechanism = sought(mechanism, CAR, STATED)
  amplitudes = {p.name: p for p in mechanism.parameters if p.null is not None}
  shapes = {p.name: p for p in mechanism.parameters if p.null is None}
  errors = {name: error.std for name, error in mechanism.sensor_errors.items()}
  tolerances = dict(mechanism.tolerances(CAR, STATED))
  assert not set(errors) & set(tolerances)
  for name in set(tolerances) & set(shapes):
    assert set(tolerances) & set(amplitudes), "a shape says nothing of what is absent"
    assert 0.0 < tolerances.pop(name) == shapes[name].std <= shapes[name].upper - shapes[name].lower
  for name, std in (errors | tolerances).items():
    assert 0.0 < std <= amplitudes[name].typical
    assert amplitudes[name].lower == amplitudes[name].null or amplitudes[name].lower <= -3.0 * std
    assert 3.0 * std <= amplitudes[name].upper
  assert mechanism.stage == "sensor" or not errors
  # their order is that of a fit's vector, and so must be stated
  assert bool(errors or tolerances) == (mechanism.fitted_rank != Mechanism.fitted_rank)


def test_errors_that_every_model_fits_have_places_of_their_own():
  ranks = [m.fitted_rank for m in ALL if m.fitted_rank != Mechanism.fitted_rank]
  assert ranks and len(set(ranks)) == len(ranks)


@each
def test_what_imitates_it_together_has_one_amplitude_in_its_unit(mechanism):
  for other in select(mechanism.imitated_by):
    assert [p.unit for p in other.parameters] == [p.unit for p in mechanism.parameters]


@each
def test_what_is_sought_far_has_room(mechanism):
  """It is tried at several times its typical size: bounds that cut most of that off would make it pointless."""
  if mechanism.sought_far:
    assert mechanism.parameters[0].upper >= 2.0 * mechanism.parameters[0].typical


@each
def test_where_the_physics_ends_is_a_bound_of_an_amplitude(mechanism):
  assert set(mechanism.whole) <= {p.name for p in mechanism.parameters if p.null is not None}


@each
def test_hooks_are_those_of_the_stage(mechanism):
  stage = {"command": "command", "actuator": "command", "force": "wrench", "contact": "write_model"}
  stage["sensor"] = "measure"
  kind = type(mechanism)
  changed = {h for h in stage.values() if getattr(kind, h) is not getattr(Mechanism, h)}
  in_the_circuit = {"write_model"} if kind.passes is not Mechanism.passes else set()
  the_cars_own = {"write_model"} if mechanism.stage == "sensor" and mechanism.subsystem != "sensor" else set()
  delays = select(["steering_delay", "drive_delay", "command_delay"])
  within_a_period = {"write_model"} if kind in map(type, delays) else set()
  assert changed == {stage[mechanism.stage]} | in_the_circuit | the_cars_own | within_a_period
  assert kind.__subclasses__() == []
  if mechanism.varies:
    assert mechanism.stage == "contact"


@each
def test_drive_and_steering_leave_each_others_command_alone(mechanism):
  """So what is known ahead of one of them can be worked out before the other."""
  if mechanism.subsystem not in ("drive", "steering") or type(mechanism).command is Mechanism.command:
    return
  own, motion, theta = ("drive", "steering").index(mechanism.subsystem), drive(), theta_of(mechanism, 1.0, 5)
  acting = run(mechanism, theta, motion)["command"]
  np.testing.assert_array_equal(acting[..., 1 - own], motion.commands[..., 1 - own])
  motion.commands[..., 1 - own] *= -0.7
  np.testing.assert_array_equal(run(mechanism, theta, motion)["command"][..., own], acting[..., own])


@each
def test_null_parameters_change_nothing(mechanism):
  """Where a twin does not even run it; so approaching the null must approach absence."""
  motion = drive()
  absent = stacked(run(Mechanism(), np.zeros((5, 0)), motion))
  at_null = stacked(run(mechanism, theta_of(mechanism, 0.0, 5), motion))
  np.testing.assert_allclose(at_null, absent, rtol=1e-6, atol=1e-7)


@each
def test_typical_size_changes_something(mechanism):
  motion = drive(steps=120)
  absent = run(Mechanism(), np.zeros((5, 0)), motion)
  present = run(mechanism, theta_of(mechanism, 1.0, 5), motion)
  columns = [(present[k][..., i], absent[k][..., i]) for k in absent for i in range(absent[k].shape[-1])]
  assert max(np.max(np.abs(a - b)) / (np.max(np.abs(b)) + 1e-6) for a, b in columns) > 1e-2


@each
def test_batch_equals_single_rows_bit_for_bit(mechanism):
  motion = drive(n=7, seed=3)
  theta = theta_of(mechanism, 1.0, 7)
  theta[:, 0] *= np.linspace(0.3, 1.4, 7)
  together = run(mechanism, theta, motion)
  for row in (0, 3, 6):
    alone = run(mechanism, theta[row : row + 1], motion.rows(slice(row, row + 1)))
    for name, value in together.items():
      axis = 0 if name == "measure" else 1
      np.testing.assert_array_equal(np.take(value, [row], axis), alone[name], err_msg=name)


@each
def test_mirrored_motion_is_mirrored_unless_declared_otherwise(mechanism):
  motion = drive(seed=5)
  theta = theta_of(mechanism, 1.0, 5)
  for i, p in enumerate(mechanism.parameters):
    theta[:, i] += 0.1 * p.scale if p.null is None else 0.0  # off any accidental symmetry
  straight = run(mechanism, theta, motion)
  mirrored = mirror_results(run(mechanism, theta, motion.mirrored()))
  far = max(np.max(np.abs(straight[k] - mirrored[k])) for k in straight)
  assert (far < 1e-9) == mechanism.symmetric


@each
def test_dissipative_ones_only_take_energy(mechanism):
  if not mechanism.dissipative:
    pytest.skip("not declared dissipative")
  motion = drive(seed=7)
  result = run(mechanism, theta_of(mechanism, 1.0, 5), motion)
  velocity = motion.signals[..., 3:6]
  assert np.all(np.sum(result["wrench"] * velocity, axis=-1) <= 1e-12)
  before = BenchModel(5).values
  for name in ("driveline_friction", "driveline_damping", "differential_damping", "differential_friction"):
    assert np.all(result[name] >= before[name])


@each
@pytest.mark.parametrize("share", [1.0, 100.0, -100.0])
def test_finite_at_standstill_and_at_the_bounds(mechanism, share):
  theta = theta_of(mechanism, share, 3)
  with np.errstate(all="raise", under="ignore"):
    result = run(mechanism, theta, still())
    rough = run(mechanism, theta, drive(n=3))
  assert np.all(np.isfinite(stacked(result))) and np.all(np.isfinite(stacked(rough)))
  if share == 1.0:
    assert np.all(result["wrench"] == 0.0)


@each
def test_corner_parameters_stay_finite(mechanism):
  """Every shape parameter at either bound, amplitude at its largest."""
  motion = drive(n=2)
  for side in ("lower", "upper"):
    row = [p.upper if p.null is not None else getattr(p, side) for p in mechanism.parameters]
    assert np.all(np.isfinite(stacked(run(mechanism, np.tile(row, (2, 1)), motion))))


@each
@pytest.mark.parametrize("column", range(3))
def test_derivative_by_size_exists(mechanism, column):
  """Central differences with steps of 1e-4 and a quarter of that agree, for every amplitude."""
  amplitudes = [i for i, p in enumerate(mechanism.parameters) if p.null is not None]
  if column >= len(amplitudes):
    pytest.skip("fewer amplitudes")
  at = amplitudes[column]
  motion = drive(seed=11)

  def slope(step):
    shifted = []
    for sign in (1, -1):
      theta = theta_of(mechanism, 0.93, 5)
      theta[:, at] += sign * step * mechanism.parameters[at].typical
      shifted.append(stacked(run(mechanism, theta, motion)))
    return (shifted[0] - shifted[1]) / (2 * step)

  coarse, fine = slope(1e-4), slope(2.5e-5)
  assert np.linalg.norm(fine) > 0
  assert np.linalg.norm(coarse - fine) < 0.1 * np.linalg.norm(fine)


@each
def test_derivative_exists_next_to_the_null(mechanism):
  """One-sided slope at 1 % and 2 % of typical: no cliff and no infinite slope where a fit starts."""
  if mechanism.name == "steering_quantisation":
    pytest.skip("a hold shorter than the change between two samples does nothing at all")
  if mechanism.from_threshold:
    pytest.skip("it does nothing below a size: a search begins above")
  motion = drive(seed=13)
  values = [stacked(run(mechanism, theta_of(mechanism, s, 5), motion)) for s in (0.0, 0.01, 0.02)]
  first, second = values[1] - values[0], values[2] - values[1]
  assert np.linalg.norm(first - second) < 0.75 * (np.linalg.norm(first) + np.linalg.norm(second))


@each
def test_state_is_rows_of_its_own_memory(mechanism):
  motion = drive(n=4)
  theta, context = theta_of(mechanism, 1.0, 4), motion.context(0)
  state = mechanism.initial(theta, context)
  for _ in range(2):
    command = motion.commands[0].copy()
    acting = mechanism.command(theta, context, state, command)
    np.testing.assert_array_equal(command, motion.commands[0])
    assert mechanism.stage not in ("command", "actuator") or acting is not command
  for name, value in state.items():
    assert len(value) == 4, name
    assert not np.shares_memory(value, motion.signals), name
    assert not np.shares_memory(value, motion.commands), name


@each
def test_sensors_leave_the_true_track_alone(mechanism):
  track = drive(n=2).track()
  before = track.signals.copy()
  mechanism.measure(theta_of(mechanism, 1.0, 2), track)
  np.testing.assert_array_equal(track.signals, before)


@each
def test_a_hook_takes_all_rows_at_once(mechanism):
  """As many calls for 500 cars as for 5: nothing loops over them."""
  if mechanism.stage == "sensor":
    pytest.skip("runs once per rollout, not per period")
  taken = []
  for n in (5, 500):
    motion, theta, model = drive(n=n, steps=2), theta_of(mechanism, 1.0, n), BenchModel(n)
    context, command = motion.context(0), motion.commands[0]
    state = mechanism.initial(theta, context)
    hook = {
      "contact": lambda c=context, t=theta, m=model: mechanism.write_model(t, c, m),
      "force": lambda c=context, t=theta, s=state: mechanism.wrench(t, c, s),
    }.get(mechanism.stage, lambda c=context, t=theta, s=state, u=command: mechanism.command(t, c, s, u))
    hook()
    taken.append(calls(hook))
  assert taken[0] == taken[1] > 0
