"""What a mechanism is: one piece of physics that can be added to the twin, with its own parameters.

A mechanism is a small final class in a file of its own. It declares its parameters, each with the
`null` value at which it is absent, and how a search should treat it, and implements those of the hooks
below that it needs. Nothing else lists mechanisms: whatever goes by a kind of them asks the declarations.
Hooks see only the simulations in which the mechanism is present (some parameter differs from its null),
as rows of arrays: n simulations side by side. So a null mechanism is not run at all, which is what makes
"null" and "absent" the same bit for bit.

Signs: ISO 8855, x forward, y left, yaw counter-clockwise.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter
from qcar_twin.plant import SIGNALS, Driving
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Stage = Literal["command", "actuator", "force", "contact", "sensor"]
Subsystem = Literal["command", "steering", "tyre", "ground", "drive", "body", "sensor"]
SUBSYSTEMS: tuple[Subsystem, ...] = get_args(Subsystem)
# from a command to what acts, and from the motion to what is logged
Link = Literal["arrival", "device", "motion", "play", "geometry", "mount", "axes", "scale", "zero", "clock"]
LINKS: tuple[Link, ...] = get_args(Link)
AS_GOOD: Mapping[str, tuple[str, ...]] = {"speed": ("motor_speed", "speed")}  # any of these stands for a needed channel
State = dict[str, Array]


@dataclasses.dataclass(frozen=True)
class CarDimensions:
  """The numbers of the car a mechanism may use.

  Measured ones of the vehicle (kg, kg m^2, m, -, rad), not fitted ones: constants of every simulation, so that a
  mechanism's parameter keeps its meaning during a fit.
  """

  mass: float
  yaw_inertia: float
  cg_to_front: float
  cg_to_rear: float
  track_width: float
  cg_height: float
  wheel_radius: float
  gear_ratio: float  # wheel speed / motor speed
  max_steering: float
  imu_x: float
  imu_y: float
  differential: str  # of driven axles: open, locked, unknown
  duty_supply: float  # V that a duty of 1 is; 0 where the drive takes no duty
  switches: bool  # whether the drive jumps or saturates with its command: it answers to no mean of two

  @classmethod
  def of(cls, vehicle: Vehicle) -> "CarDimensions":
    """Of a vehicle, as measured."""
    measured = {f.name: getattr(vehicle, f.name) for f in dataclasses.fields(cls)[:-2]}
    supply = vehicle.supply_voltage if vehicle.drive == "duty" else 0.0
    return cls(**measured, duty_supply=supply, switches=vehicle.drive in ("duty", "speed"))

  @property
  def wheelbase(self) -> float:
    return self.cg_to_front + self.cg_to_rear


@dataclasses.dataclass
class Context:
  """What is known at the start of a control period, for the n simulations in which a mechanism is present.

  Attributes:
    car: the car's measured numbers.
    period: control period, s.  time: since each segment's start, s.
    signals: state of the car, (n, 10), columns in the order of SIGNALS.
    commands: logged commands of this period before any mechanism, (n, 2): V, rad; A or m/s, rad where the drive's
      command is one; a duty is in volts.
    history: seconds driven and V^2 s spent before the segment, (n, 2).
    recording_time: time since the start of the recording, s, (n,).
    pose: x, y, yaw a place- or heading-bound effect looks up, (n, 3): measured where known, else simulated.
    wheel_angle: angle the wheels have turned since the start of the recording, rad, (n,): measured where an encoder
      was logged, else simulated since the start of the segment.
    torque_per_volt: fitted motor torque per unit of the drive's command, N m / V (A, m/s), motor side, (n,).
    motor_damping: fitted damping of the motor, N m s / rad, motor side, (n,): with it, the part of the
      voltage that drives current is V - motor_damping / torque_per_volt * motor_speed.
    max_torque: largest torque of the motor, N m, (n,); inf without a limit.
    drive_hold: periods, below 2, for which the motor still gets what it got before, (n,).
    before: for `initial` and the first `write_model` alone, commands of the K periods before the segment, (n, K, 2),
      the newest last, for the former as the mechanisms before hold them back; NaN where nobody knows, None where nobody
      knows any.
    lead: the drive before the segment, (n, 4), in the order of LEAD (qcar_twin/plant.py), with the drive command that
      the motion took in place of its acceleration; NaN where the car stood or nobody knows.
  """

  car: CarDimensions
  period: float
  time: float
  signals: Array
  commands: Array
  history: Array
  recording_time: Array
  pose: Array
  wheel_angle: Array
  torque_per_volt: Array
  motor_damping: Array
  max_torque: Array | float = np.inf
  drive_hold: Array | float = 0.0
  lead: Array | None = None
  before: Array | None = None

  def signal(self, name: str) -> Array:
    """One signal by name, (n,)."""
    return self.signals[:, SIGNALS.index(name)]


@dataclasses.dataclass(frozen=True)
class Track:
  """A whole rollout, for the sensor side.

  Attributes:
    car: the car's measured numbers.
    period: control period, s.
    signals: (n, T + 1, 10), columns in the order of SIGNALS.
    recording_time: time since the start of the recording, s, (n, T + 1).
    own: nobody else looks at `signals`, so what a sensor shows may be written over them.
  """

  car: CarDimensions
  period: float
  signals: Array
  recording_time: Array
  own: bool = False

  def signal(self, name: str) -> Array:
    return self.signals[..., SIGNALS.index(name)]


class Model(Protocol):
  """The physical quantities a mechanism may change in the simulator, per simulation.

  Quantities (n rows): wheel-wise, (n, 4) in the order front_left front_right rear_left rear_right:
  `cornering_stiffness` [N/rad per wheel], `longitudinal_stiffness` [N per unit slip, per wheel],
  `friction_coefficient` [-], `tyre_shape` [-], `load_exponent` [-], `relaxation_length`, `longitudinal_relaxation` [m];
  car-wise, (n,): `gravity_x`, `gravity_y` [m/s^2, world frame], `driveline_friction` [N m, motor side],
  `driveline_damping` [N m s/rad, motor side], `torque_per_volt` [N m/V, motor side], `motor_damping`
  [N m s/rad, motor side], `max_torque` [N m, motor side, where it has a limit], `supply_sag` [1/V^2],
  `rotor_inertia` [kg m^2, motor side], `wheel_inertia` [kg m^2, of one wheel about the axle],
  `differential_damping` [N m s/rad per axle], `centre_differential` [-, 0 one shaft],
  `servo_time_constant` [s], `servo_rate` [rad/s, inf without a limit], `steering_hold` [periods, below 2, for which
  the servo still goes to the angles told before], `drive_hold` [periods, below 2, for which the motor still gets what
  it got before], `one_way`, `one_way_brake`, `one_way_neutral`, `one_way_weakness`, `one_way_reverse` [-, shares of a
  speed controller], `braked_at_first` [what its brake does at a start, engines/controller.py], `ackermann_fraction`
  [-], `added_mass` [kg], `added_mass_x` [m, from the CG], `added_mass_y` [m],
  `cg_height_offset` [m], `cg_lateral_offset` [m].
  """

  def get(self, quantity: str) -> Array:
    """Present values, (n, 4) or (n,): the fitted ones plus what earlier mechanisms changed."""
    ...

  def set(self, quantity: str, value: Array) -> None: ...


@dataclasses.dataclass(frozen=True)
class SensorError:
  """An error that every sensor of its kind has: every model fits it, and only one far beyond it is claimed.

  Attributes:
    std: its usual size, a standard deviation in the parameter's unit.
    read_at_rest: channel whose mean is this error while the car stands; "" where something else may show there, too.
    wander: by how much it may differ between rest and drive, a standard deviation.
    per_period: of an age, what comes on top for each s between two samples, s: a logger that averages over a period or
      counts in it shows what was half a period ago, and one that does not shows what is, which is two deviations.
    as_logged: what comes on top where it is logged as another channel than that of the sensor itself, a standard
      deviation by channel.
  """

  std: float
  read_at_rest: str = ""
  wander: float = 0.0
  per_period: float = 0.0
  as_logged: Mapping[str, float] = dataclasses.field(default_factory=dict)


class Mechanism:
  """Base of all mechanisms; see the module's text.

  Class attributes:
    name: canonical id.
    subsystem: where a report says it belongs.
    stage: where it acts: command (what reaches the actuators), actuator (voltage and steering as functions of the
      car's state), force (on the body), contact (quantities of the simulator), sensor (what is logged).
    link: its place in the signal chain, which orders the mechanisms of a stage. Commands: arrival (resolution, dead
      time, supply), device (how servo or motor controller reads them), motion (lags), play, geometry (of the linkage),
      zero. Sensors: mount, axes, scale, zero, clock.
    parameters: at least one; each with null, typical and a prior standard deviation or None.
    needs: channels without which it cannot be distinguished ("yaw_rate", ...), or one that is AS_GOOD.
    replaced_by: recorded channels in whose place what it errs in stands: with one of them it cannot be.
    dissipative: True if it can only take energy out of the car.
    symmetric: True if mirrored commands give mirrored motion under it.
    varies: True if `write_model` must run every control period instead of once.
    open_loop: True if `command` goes by commands, time and its own state alone, never by how the car moves: its context
      holds no signals then, and a whole drive's commands are worked out before the car is simulated.
    signed: True if negative sizes are meaningful.
    drives: kinds of drive command it makes sense for; see qcar_twin/vehicle/drive.py.
    nonlinear_response: True if its answer is far from proportional to its size (delays, changes of grip, a centre of
      gravity off the middle), so that a scan at one size tells little of another and a search should refit it
      whatever the scan says.
    sought_far: True if it may be so large that it is also sought at several times its typical size on parameters that
      recalibration has not bent (delays and lags).
    from_threshold: True if it does nothing below a size that the driving decides (a limit that is never reached), so
      that a scan tries it at several.
    curve: True if it only outlines what named mechanisms may be: a calibration fits it, a diagnosis never names it.
    outlined_by: id of the curve that it is one form of; "" for none. Its hooks go by present command and speed alone.
    absorbed_by_drive: True if recalibration imitates it by parameters of the drive, as it does subsystem "drive".
    whole: amplitudes whose upper bound is where the physics ends, and no end of a search: none is stretched there.
    imitated_by: ids of mechanisms, of one amplitude each in the same unit, that do together what it does: a search also
      begins where what they have in common is put on it.
    sensor_errors: amplitudes that every sensor of the kind has some of, by parameter.
    of_pose: True if what errs is the pose: `begin` is for those states of a start that were read off the pose, and for
      no other; without it, for those that a sensor of their own said.
    of_wheels: True if what errs is how fast wheels turn: `begin` is for what a measured speed has of theirs.
    fitted_rank: place among the errors that every model fits (`sensor_errors`, `tolerances`), lowest first and by name
      where equal: their order in a fit's vector.
  """

  name: ClassVar[str]
  subsystem: ClassVar[Subsystem]
  stage: ClassVar[Stage]
  link: ClassVar[Link] = "zero"
  parameters: ClassVar[tuple[Parameter, ...]]
  needs: ClassVar[tuple[str, ...]] = ()
  replaced_by: ClassVar[tuple[str, ...]] = ()
  dissipative: ClassVar[bool] = False
  symmetric: ClassVar[bool] = True
  varies: ClassVar[bool] = False
  open_loop: ClassVar[bool] = False
  signed: ClassVar[bool] = False
  drives: ClassVar[tuple[str, ...]] = tuple(DRIVES)
  nonlinear_response: ClassVar[bool] = False
  sought_far: ClassVar[bool] = False
  from_threshold: ClassVar[bool] = False
  absorbed_by_drive: ClassVar[bool] = False
  curve: ClassVar[bool] = False
  outlined_by: ClassVar[str] = ""
  whole: ClassVar[tuple[str, ...]] = ()
  imitated_by: ClassVar[tuple[str, ...]] = ()
  sensor_errors: ClassVar[Mapping[str, SensorError]] = {}
  of_pose: ClassVar[bool] = False
  of_wheels: ClassVar[bool] = False
  fitted_rank: ClassVar[int] = 100

  def initial(self, theta: Array, context: Context) -> State:
    """Hidden state at a segment's start: named arrays whose first axis is n. theta is (n, p).

    On stage "command" the context's commands and steering angle are those that the mechanisms before leave of the first
    command and of the angle that stands.
    """
    return {}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    """Commands that act, (n, 2): V, rad, from those that came in, (n, 2); may change `state`.

    A loop that answers to the motor puts into `state["held"]`, (n, 2), what it makes now of the drive's commands of the
    two periods before, the newer first: for `drive_hold` they act still. Subsystem "drive" changes the first column
    alone and subsystem "steering" the second, whatever the other is.
    """
    return command

  def past(self, theta: Array, before: Array, period: float) -> Array:
    """Commands before a segment, (n, K, 2), as it leaves those that came in: only what holds commands back has to say.

    Args:
      before: the newest last, NaN where nobody knows.
      period: control period, s.
    """
    return before

  def passes(self, theta: Array) -> NDArray[np.bool_]:
    """Cars, (n,), whose commands it leaves as they are with parameters (n, p): what it does `write_model` has done."""
    return np.zeros(len(theta), dtype=bool)

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    """Force on the body at the CG, (n, 3): F_x [N], F_y [N], M_z [N m], body frame; may change `state`."""
    return np.zeros((len(theta), 3))

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    """Change quantities of the simulator."""

  def begin(self, theta: Array, start: Array, rate: Array) -> Array:
    """Start states (N, 7), in the order of START, of cars whose sensors err as this mechanism says.

    Args:
      theta: parameters, (N, p).
      start: states as the sensors showed them.
      rate: how fast they changed there, per s, (N, 7); 0 where nobody knows.
    """
    return start

  def own_share(self, theta: Array) -> Array:
    """Share, (N,), that the car's own speed has in what the log calls so; the rest is that of its wheels."""
    return np.zeros(len(theta))

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Standard deviations of amplitudes that any description of a car leaves open, by parameter; 0 for none.

    Every model fits them within three of these, so that they are not taken for physics.

    Args:
      car: the car's measured numbers.
      std: standard deviations stated with them, by name of the vehicle's number.
    """
    return {}

  def observable_share(self, values: Mapping[str, float], driving: Driving) -> float:
    """Share of the amplitudes that the driving can show, 0 to 1.

    What comes before the driving began is there all along: the car's other parameters have taken it in.
    """
    return 1.0

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Values of the shape parameters from which a search begins; more than one where one start can miss it."""
    return ({},)

  def measure(self, theta: Array, track: Track) -> Array:
    """Signals as the sensors show them, (n, T + 1, 10), from the true ones in `track`."""
    return track.signals


def describe(mechanism: Mechanism) -> Mapping[str, Any]:
  """What reports print of a mechanism: name, subsystem, first line, equation and parameters."""
  text = (type(mechanism).__doc__ or "").strip()
  return {
    "name": mechanism.name,
    "subsystem": mechanism.subsystem,
    "stage": mechanism.stage,
    "summary": text.splitlines()[0] if text else "",
    "text": text,
    "parameters": {p.name: p.unit for p in mechanism.parameters},
  }


def in_chain(mechanisms: Iterable[Mechanism]) -> tuple[Mechanism, ...]:
  """The same from the command to the log: by stage, then by link, and those of one link in the order given."""
  stages = get_args(Stage)
  return tuple(sorted(mechanisms, key=lambda m: (stages.index(m.stage), LINKS.index(m.link))))
