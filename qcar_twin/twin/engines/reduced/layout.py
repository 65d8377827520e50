"""Names and places of a reduced car's state, numbers and constants; the C header is written from these lists.

Rows of arrays with the cars along the second axis; four rows a name, in the order of WHEELS, for what every wheel has.
"""

from collections.abc import Mapping, Sequence

STATE = (
  "X",  # m, world frame, of the chassis frame's origin
  "Y",
  "YAW",  # rad, unwrapped
  "COSINE",  # of the heading
  "SINE",
  "VELOCITY_X",  # m/s, world frame
  "VELOCITY_Y",
  "YAW_RATE",  # rad/s
  "ROLL",  # rad
  "PITCH",
  "HEAVE",  # m
  "ROLL_RATE",  # rad/s
  "PITCH_RATE",
  "HEAVE_RATE",  # m/s
  "MOTOR",  # rad/s
  "FRONT_DIFFERENCE",  # left minus right wheel speed, rad/s
  "REAR_DIFFERENCE",
  "CENTRE_DIFFERENCE",  # front minus rear axle's mean wheel speed, rad/s
  "SERVO",  # mean road-wheel angle, rad
  "SERVO_BEFORE",  # of the step before
  "SERVO_RATE",  # times its lag, rad
  "TOLD",  # angle that the servo was told in the period before, rad
  "TOLD_BEFORE",
  "DRIVEN",  # drive's command of the period before, in its unit; NaN at a start
  "DRIVEN_BEFORE",
  "BRAKED",  # what a speed controller's brake does, see engines/controller.py; NaN at a start
)
WHEEL_STATE = (
  "SLIP_X",
  "SLIP_Y",
  "LOAD",  # N; -1 before the first step
  "HEIGHT",  # of the wheel above the floor, m; < 0 pressed into it
  "RISE",  # m/s
)
NUMBERS = (
  "TORQUE_PER_COMMAND",
  "MOTOR_DAMPING",
  "MAX_TORQUE",
  "SUPPLY_SAG",  # resistance of the supply over the motor's, per squared volt of the command
  "DRIVELINE_FRICTION",
  "DRIVELINE_DAMPING",
  "DIFFERENTIAL_DAMPING",
  "DIFFERENTIAL_FRICTION",
  "CENTRE_DAMPING",  # between the axles, N m s/rad
  "GRAVITY_X",  # m/s^2, world frame
  "GRAVITY_Y",
  "SERVO_A",  # how the servo's error and rate go on in a step, see engines/servo.py
  "SERVO_B",
  "SERVO_C",
  "SERVO_D",
  "SERVO_STEP",  # that the servo turns at most in a step, rad
  "SERVO_MOST",  # its highest rate times its lag, rad
  "STEERING_HOLD",  # periods for which it still goes to the angles told before
  "ONE_WAY",  # of a speed controller, see engines/controller.py
  "ONE_WAY_BRAKE",
  "ONE_WAY_NEUTRAL",
  "ONE_WAY_WEAKNESS",
  "ONE_WAY_REVERSE",
  "BRAKED_AT_FIRST",
  "DRIVE_HOLD",  # periods for which the motor still gets what it got before
  "ACKERMANN",  # half difference of the road-wheel angles per squared mean, 1/rad
  "MASS",
  "MOMENT_X",  # mass times place of the whole car, kg m
  "MOMENT_Y",
  "MOMENT_Z",
  "YAW_INERTIA",  # of the whole car about the chassis frame, kg m^2
  "ROLL_INERTIA",
  "PITCH_INERTIA",
  "YAW_ROLL_INERTIA",  # products
  "YAW_PITCH_INERTIA",
  "SPRUNG_MASS",
  "SPRUNG_X",  # m, chassis frame
  "SPRUNG_Y",
  "SPRUNG_Z",
  "SPINNING_INERTIA",  # rotor and wheels at the motor, kg m^2
  "WHEEL_INERTIA",  # of one wheel about the axle, kg m^2
  "SPRING",  # N/m
  "DAMPER",  # N s/m
  "CG_SHIFT",  # of the fitted centre of gravity ahead of the measured one, m
)
WHEEL_NUMBERS = (
  "CORNERING_STIFFNESS",
  "LONGITUDINAL_STIFFNESS",
  "FRICTION_COEFFICIENT",
  "RELAXATION_LENGTH",
  "LONGITUDINAL_RELAXATION",
  "TYRE_SHAPE",
  "LOAD_EXPONENT",
  "RIM_MASS",  # that turns with the wheel, at its rim, kg
)
CONSTANTS = (
  "STEP",  # s
  "GRAVITY",  # m/s^2
  "FRONT_LOAD",  # static, of one wheel, N
  "REAR_LOAD",
  "FRONT_PRELOAD",  # of one spring at rest, N
  "REAR_PRELOAD",
  "CARCASS_DAMPING",
  "FRONT_X",  # m
  "REAR_X",
  "HALF_TRACK",
  "ORIGIN_HEIGHT",  # of the chassis frame above the patch, m
  "ROLLING_RADIUS",
  "ROLL_ARM",  # from the chassis frame down to where the patch's normal meets the middle plane, m
  "PITCH_ARM",
  "FRONT_SHARE",  # of CENTRE_DIFFERENCE by which this axle is faster than the motor: 1/2; 1 of one that is not driven
  "REAR_SHARE",  # by which it is slower
  "FRONT_DRIVEN",  # 1 if the axle has a differential, 0 if its wheels roll each for itself
  "REAR_DRIVEN",
  "KNUCKLE_INERTIA",  # of two road wheels about their steering axes, kg m^2
  "WHEEL_MASS",
  "GEAR",
  "IMU_X",
  "IMU_Y",
  "MAX_STEERING",
  "MAX_COMMAND",
  "DUTY_SUPPLY",  # that a duty of 1 is, V; 0 where the drive takes no duty
  "NEUTRAL",  # command that a speed controller takes for none, V
  "STANDS",  # back-EMF of a motor that it takes for one that stands, V
  "CORNER",  # over which its diodes open, V
  "SINKING",  # m
  "CONTACT_DAMPING",  # 1/s, of MuJoCo's soft row
  "CONTACT_STIFFNESS",  # 1/s^2
  "CONTACT_SOFTNESS",  # regularisation, 1/kg
  "PATCH_MOBILITY",  # mean inverse mass that a wheel's patch moves along the ground with, 1/kg
)


def rows(names: Sequence[str], wheel_names: Sequence[str] = ()) -> Mapping[str, int]:
  """First row of every name."""
  first = {name: i for i, name in enumerate(names)}
  return first | {name: len(names) + 4 * i for i, name in enumerate(wheel_names)}


STATE_ROW, NUMBER_ROW, CONSTANT_ROW = rows(STATE, WHEEL_STATE), rows(NUMBERS, WHEEL_NUMBERS), rows(CONSTANTS)
N_STATE, N_NUMBER = len(STATE) + 4 * len(WHEEL_STATE), len(NUMBERS) + 4 * len(WHEEL_NUMBERS)


def header() -> str:
  """layout.h: the same places as C enums, prefixed S_, P_ and C_."""
  lines = []
  for prefix, table in (("S", STATE_ROW), ("P", NUMBER_ROW), ("C", CONSTANT_ROW)):
    lines.append(f"enum {{ {', '.join(f'{prefix}_{name} = {row}' for name, row in table.items())} }};")
  return "\n".join([*lines, ""])
