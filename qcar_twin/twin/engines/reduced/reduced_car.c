// The reduced car: what MuJoCo computes for qcar.xml, written out for this one structure. Equations: docs/reference/reduced.md.
//
// Unknowns of a step are the velocities at its end: the car's along x and y of the heading in its middle, yaw, roll and
// pitch rate, the wheel speed differences of both axles and between them, the motor's speed. All forces that depend on
// them (tyres, differentials, Coulomb friction) are implicit, so the step is one symmetric 9 x 9 system; springs,
// gravity and the motor's torque are those of its beginning, as in MuJoCo's semi-implicit Euler.
//
// Arrays: row r of state S and numbers P holds one quantity of all cars, `stride` doubles a row, a multiple of LANES.

#include "lanes.h"
#include "layout.h"

#define CREEP_SPEED 0.005  // m/s; this and the next four as in vehicle/tyre/tyre.c
#define DAMPED_SPEED 0.1
#define LEAST_LOAD 0.02
#define CONE_RESERVE 1.5
#define GRAVITY 9.81
#define SLOWEST_SLIDE 0.05  // rad/s, below which a differential's Coulomb friction is viscous
#define FLOWN_APART 1e6    // a signal beyond it, in SI units, is none: the parameters make no car
#define N_SIGNAL 10

enum { VX, VY, YAW, ROLL, PITCH, FRONT, REAR, CENTRE, MOTOR, N_UNKNOWN };
#define WHEELS UNROLLED for (int k = 0; k < 4; k++)
#define AT(i, j) ((i) * ((i) + 1) / 2 + (j))  // place in a lower triangle, j <= i

typedef struct {
  const double *C, *P;
  double* S;
  long stride;
} Cars;

INLINE V number(const Cars* a, int row) { return load(a->P + row * a->stride); }
INLINE V state(const Cars* a, int row) { return load(a->S + row * a->stride); }
INLINE void put(const Cars* a, int row, V value) { store(a->S + row * a->stride, value); }

// a direction over the ground
typedef struct { V x, y; } Pair;

INLINE Pair turned(Pair a, V s, V c) { return (Pair){c * a.x - s * a.y, s * a.x + c * a.y}; }

// what the tyres add to the system: along the car's plane (vx, vy, yaw), and of each axle the mean wheel speed and the
// difference
typedef struct {
  V plane[6], plane_mean[2][3], plane_axle[2][3], mean[2], mean_axle[2], axle[2];
  V to_plane[3], to_mean[2], to_axle[2];
} Tyres;

// a wheel in this step: rows of its slip velocity over (vx, vy, yaw), and how its slips go on
typedef struct {
  V along[3], across[3];
  Pair turning;  // slip velocity that the end's heading adds, m/s
  Pair kept;     // of the slips of now
  Pair gain;     // slip at the end per slip velocity at the end, s/m; 0 in the air
} Wheel;

// the springs' and floor's part of a step
typedef struct {
  V load[4];    // N; -1 in the air
  V acceleration[4];  // of the wheel without the floor's force, m/s^2, downwards
  V sum, about_x, about_y;  // of the springs on the body: N, N m
} Suspension;

INLINE double side_of(int k) { return k % 2 ? -1. : 1.; }  // 1 left, -1 right

// Wheels on springs; the floor is MuJoCo's soft contact row, a reference acceleration with a regularisation.
INLINE void suspend(const Cars* a, V roll, V pitch, V heave, V roll_rate, V pitch_rate, V heave_rate, Suspension* out) {
  const double *C = a->C, mass = C[C_WHEEL_MASS];
  V spring = number(a, P_SPRING), damper = number(a, P_DAMPER);
  out->sum = out->about_x = out->about_y = all(0);
  WHEELS {
    V x = C[k < 2 ? C_FRONT_X : C_REAR_X] - number(a, P_SPRUNG_X), y = side_of(k) * C[C_HALF_TRACK] - number(a, P_SPRUNG_Y);
    V height = state(a, S_HEIGHT + k), rise = state(a, S_RISE + k);
    V force = C[k < 2 ? C_FRONT_PRELOAD : C_REAR_PRELOAD] -
              spring * (heave + y * roll - x * pitch - height - C[C_SINKING]) -
              damper * (heave_rate + y * roll_rate - x * pitch_rate - rise);
    V falling = C[C_GRAVITY] + force * (1 / mass);
    V pressed = (falling - C[C_CONTACT_DAMPING] * rise - C[C_CONTACT_STIFFNESS] * height) *
                (1 / (1 / mass + C[C_CONTACT_SOFTNESS]));
    out->load[k] = pick(height < 0, most(pressed, all(0)), all(-1));
    out->acceleration[k] = falling;
    out->sum += force;
    out->about_x += force * y;
    out->about_y += force * x;
  }
}

// Weight of a step's end in the slips, 1 - 3 / (6 + h z), z of a slip's two rates the slower one, or their geometric
// mean where they swing; as in tyre.c. Here z = 2 rate / d.
INLINE V lateness(double h, V length, V speed, V rate) {
  V four = 4 * length * rate, d = most(speed + root(most(speed * speed - four, all(0))), root(four));
  return 1 - 3 * d / (6 * d + 2 * h * rate);
}

// What a wheel does in a step, as the car moves it.
typedef struct {
  V speed;      // rad/s
  V st, ct;     // of its steering angle at the beginning
  V s, c;       // and in the middle of the step
  V turn;       // of its heading in half a step, rad
} Motion;

// Tyre numbers that a period keeps.
typedef struct { V by_rim_mass[4], by_shape[4], damping[4]; } Fixed;

// The tyres of all wheels: the law and its secant as in tyre.c, added to the system.
//   now, before: the car's velocity in the heading of the step's middle and beginning, m/s
//
// Loops over the wheels follow one another, so that a processor finds four chains of operations to work on at once.
INLINE void roll_wheels(const Cars* a, Pair now, Pair before, V yaw_rate, V roll_rate, V pitch_rate, const Motion motion[4],
                        const Fixed* fixed, V pressed[4], Wheel wheels[4], Tyres* sum) {
  const double *C = a->C, h = C[C_STEP], radius = C[C_ROLLING_RADIUS], height = C[C_ORIGIN_HEIGHT];
  const double front = C[C_FRONT_LOAD], rear = C[C_REAR_LOAD];
  V rolling[4], vx[4], vy[4], load[4], ratio[4], fall[4], stiff_x[4], stiff_y[4], friction[4], reference[4];
  V late_x[4], late_y[4], inverse_x[4], inverse_y[4], zx[4], zy[4], rho[4], size[4], px[4], py[4], secant[4], gx[4], gy[4], damping[4], firm[4];
  V pull_x[4], pull_y[4], qx[4], qy[4], edge[4], share[4];
  Mask unset[4];
  V ux = now.x - height * pitch_rate, uy = now.y + height * roll_rate;

  // load, and what falls with it
  WHEELS {
    V nominal = all(k < 2 ? front : rear), old = state(a, S_LOAD + k);
    unset[k] = old < 0;
    load[k] = pick(unset[k], nominal, most(old, LEAST_LOAD * nominal)), ratio[k] = load[k] * (1 / (k < 2 ? front : rear));
  }
  WHEELS fall[k] = logarithm(ratio[k]);
  WHEELS fall[k] = exponential(-number(a, P_LOAD_EXPONENT + k) * fall[k]);

  // slip velocity: translation along the heading of the middle of the step, rotation as it is now
  WHEELS {
    const Motion* o = motion + k;
    Wheel* w = wheels + k;
    const double x = C[k < 2 ? C_FRONT_X : C_REAR_X], y = side_of(k) * C[C_HALF_TRACK];
    w->along[0] = o->c, w->along[1] = o->s, w->along[2] = o->st * x - o->ct * y;
    w->across[0] = -o->s, w->across[1] = o->c, w->across[2] = o->ct * x + o->st * y;
    w->turning = (Pair){o->turn * (o->ct * before.y - o->st * before.x), -o->turn * (o->ct * before.x + o->st * before.y)};
    rolling[k] = radius * o->speed;
    vx[k] = w->along[0] * ux + w->along[1] * uy + w->along[2] * yaw_rate - rolling[k] - w->turning.x;
    vy[k] = w->across[0] * ux + w->across[1] * uy + w->across[2] * yaw_rate - w->turning.y;
    reference[k] = root(rolling[k] * rolling[k] + vx[k] * vx[k] + vy[k] * vy[k] + CREEP_SPEED * CREEP_SPEED);
    stiff_x[k] = number(a, P_LONGITUDINAL_STIFFNESS + k) * fall[k] * ratio[k];
    stiff_y[k] = number(a, P_CORNERING_STIFFNESS + k) * fall[k] * ratio[k];
    friction[k] = number(a, P_FRICTION_COEFFICIENT + k) * fall[k];
  }
  WHEELS {
    late_x[k] = lateness(h, number(a, P_LONGITUDINAL_RELAXATION + k), reference[k], stiff_x[k] * fixed->by_rim_mass[k]);
    late_y[k] = lateness(h, number(a, P_RELAXATION_LENGTH + k), reference[k], stiff_y[k] * (GRAVITY / (k < 2 ? front : rear)));
  }

  // transient slip, its linear force in units of friction times load, and the law's secant there
  WHEELS {
    V lx = number(a, P_LONGITUDINAL_RELAXATION + k), ly = number(a, P_RELAXATION_LENGTH + k);
    inverse_x[k] = 1 / (lx + h * late_x[k] * reference[k]), inverse_y[k] = 1 / (ly + h * late_y[k] * reference[k]);
    V by_reference = 1 / reference[k];
    zx[k] = pick(unset[k], vx[k] * by_reference, state(a, S_SLIP_X + k));
    zy[k] = pick(unset[k], vy[k] * by_reference, state(a, S_SLIP_Y + k));
    gx[k] = h * late_x[k] * inverse_x[k], gy[k] = h * late_y[k] * inverse_y[k];
    px[k] = stiff_x[k] * (lx * inverse_x[k] * zx[k] + gx[k] * vx[k]);
    py[k] = stiff_y[k] * (ly * inverse_y[k] * zy[k] + gy[k] * vy[k]);
    size[k] = root(px[k] * px[k] + py[k] * py[k]);
    rho[k] = size[k] / (friction[k] * load[k]);
  }
  WHEELS secant[k] = arctangent(rho[k] * fixed->by_shape[k]);
  WHEELS secant[k] = sine(number(a, P_TYRE_SHAPE + k) * secant[k]);
  WHEELS secant[k] = pick(rho[k] < 1e-4, all(1), secant[k] / most(rho[k], all(1e-4)));

  WHEELS {
    V fade = DAMPED_SPEED * DAMPED_SPEED / (DAMPED_SPEED * DAMPED_SPEED + rolling[k] * rolling[k]);
    damping[k] = fixed->damping[k] * fade * fade;
    firm[k] = secant[k] - damping[k] * reference[k];
    // pull: force per slip velocity in the step
    pull_x[k] = stiff_x[k] * (firm[k] * gx[k] + damping[k]), pull_y[k] = stiff_y[k] * (firm[k] * gy[k] + damping[k]);
    qx[k] = pull_x[k] * late_x[k], qy[k] = pull_y[k] * late_y[k];
    // The elliptic cone around the law holds a load that has vanished within the step. Its half axes are the reserve
    // times friction for the weaker direction, and in the ratio of their roots.
    V across = qy[k] * px[k] * px[k] + qx[k] * py[k] * py[k];
    edge[k] = CONE_RESERVE * friction[k] * size[k] * root(most(qx[k], qy[k]) / most(across, all(1e-30)));
  }
  // at its corner MuJoCo's solver shares what the tyre wants between the floor's push and the friction
  WHEELS {
    V wanted = size[k] * secant[k], stiff = all(1 / C[C_WHEEL_MASS] + C[C_CONTACT_SOFTNESS]);
    V weight = .5 * h * (qx[k] + qy[k]), soft = 1 + weight * C[C_PATCH_MOBILITY];
    V shared = (weight * stiff * pressed[k] + edge[k] * soft * wanted) / (weight * stiff + edge[k] * edge[k] * soft);
    Mask grounded = pressed[k] > -.5, beyond = edge[k] * pressed[k] < wanted;
    share[k] = pick(beyond, edge[k] * shared / most(wanted, all(1e-9)), all(1));
    share[k] = pick(grounded, share[k], all(0));
    pressed[k] = pick(grounded, pick(beyond, shared, pressed[k]), all(-1));
  }

  WHEELS {
    Wheel* w = wheels + k;
    V lx = number(a, P_LONGITUDINAL_RELAXATION + k), ly = number(a, P_RELAXATION_LENGTH + k);
    V hold_x = stiff_x[k] * firm[k] * lx * inverse_x[k], hold_y = stiff_y[k] * firm[k] * ly * inverse_y[k];
    Mask grounded = pressed[k] > -.5;
    pressed[k] = most(pressed[k], all(0));

    // force on the car  f = -c v(end) - b  along both directions
    V cx = h * share[k] * qx[k], cy = h * share[k] * qy[k];
    V bx = h * share[k] * (hold_x * zx[k] + pull_x[k] * (1 - late_x[k]) * vx[k]) + cx * w->turning.x;
    V by = h * share[k] * (hold_y * zy[k] + pull_y[k] * (1 - late_y[k]) * vy[k]) + cy * w->turning.y;
    V spin = all(-radius), differ = all(-radius * .5 * side_of(k));  // rows over the axle's mean speed and difference
    const int axle = k / 2;
    UNROLLED for (int i = 0; i < 3; i++) {
      V ax = cx * w->along[i], ay = cy * w->across[i];
      UNROLLED for (int j = 0; j <= i; j++) sum->plane[AT(i, j)] += ax * w->along[j] + ay * w->across[j];
      sum->plane_mean[axle][i] += ax * spin;
      sum->plane_axle[axle][i] += ax * differ;
      sum->to_plane[i] -= w->along[i] * bx + w->across[i] * by;
    }
    sum->mean[axle] += cx * spin * spin;
    sum->mean_axle[axle] += cx * spin * differ;
    sum->axle[axle] += cx * differ * differ;
    sum->to_mean[axle] -= spin * bx;
    sum->to_axle[axle] -= differ * bx;

    V before_x = h * (1 - late_x[k]), before_y = h * (1 - late_y[k]);
    V kept_x = ((lx - before_x * reference[k]) * zx[k] + before_x * vx[k]) * inverse_x[k];
    V kept_y = ((ly - before_y * reference[k]) * zy[k] + before_y * vy[k]) * inverse_y[k];
    w->gain = (Pair){pick(grounded, gx[k], all(0)), pick(grounded, gy[k], all(0))};
    w->kept = (Pair){pick(grounded, kept_x, all(0)), pick(grounded, kept_y, all(0))};
  }
}

// Solves A u = b in place of b; A is lost. Coulomb friction on the last unknown, the motor, takes at most `friction` off
// its impulse: with all others eliminated that is a clip.
INLINE void solve(V A[], V b[], V friction) {
  V diagonal[N_UNKNOWN], scaled[N_UNKNOWN];
  UNROLLED for (int j = 0; j < N_UNKNOWN; j++) {
    V d = A[AT(j, j)];
    UNROLLED for (int k = 0; k < j; k++) {
      scaled[k] = A[AT(j, k)] * diagonal[k];
      d -= scaled[k] * A[AT(j, k)];
      b[j] -= A[AT(j, k)] * b[k];
    }
    diagonal[j] = d;
    V inverse = 1 / d;
    A[AT(j, j)] = inverse;
    UNROLLED for (int i = j + 1; i < N_UNKNOWN; i++) {
      V off = A[AT(i, j)];
      UNROLLED for (int k = 0; k < j; k++) off -= A[AT(i, k)] * scaled[k];
      A[AT(i, j)] = off * inverse;
    }
  }
  b[MOTOR] -= clip(b[MOTOR], friction);
  UNROLLED for (int j = N_UNKNOWN - 1; j >= 0; j--) {
    b[j] *= A[AT(j, j)];
    UNROLLED for (int k = j + 1; k < N_UNKNOWN; k++) b[j] -= A[AT(k, j)] * b[k];
  }
}

// A command of which the one before acts for the first `share` of a period.
typedef struct { V older, newer, share; } Held;

// By a number of periods below 2 that it is held; rows of the state: what was told in the period before, and before that.
// NaN there is what nobody knows: the same as now.
INLINE Held held(const Cars* a, int told_row, int hold_row, V command) {
  V told = state(a, told_row), before = state(a, told_row + 1), hold = number(a, hold_row);
  told = pick(told == told, told, command), before = pick(before == before, before, told);
  return (Held){pick(hold >= 1, before, told), pick(hold >= 1, told, command), hold - pick(hold >= 1, all(1), all(0))};
}

// Share of step n of `count` in which the older command still acts.
INLINE V still_older(const Held* c, int n, int count) { return most(least(c->share * count - n, all(1)), all(0)); }

// What acts of a command on a motor of this back-EMF, V, and what the brake does then: controller.py in C.
INLINE V controlled(const Cars* a, V told, V back_emf, V* braked) {
  const double* C = a->C;
  V way = pick(back_emf < 0, all(-1), all(1)), along = told * way, back = back_emf * way;
  V ratio = least(absolute(told) * (1 / C[C_NEUTRAL]), all(1e3)), emf2 = back_emf * back_emf;
  ratio *= ratio;
  V idle = 1 / (1 + ratio * ratio), moves = emf2 / (emf2 + C[C_STANDS] * C[C_STANDS]);
  Mask active = idle < .5, held = (told < 0) & active & ((*braked > .5) | ((back_emf > 0) & (moves > .5)));
  *braked = pick(held, all(1), pick((*braked > 1.5) & ~active, all(2), all(0)));
  V shorted = least(absolute(told) * (1 / C[C_DUTY_SUPPLY]), all(1)) * (1 - number(a, P_ONE_WAY_WEAKNESS));
  V beyond = most(back - along, all(0)), stopped = beyond * beyond / (beyond + C[C_CORNER]);
  V braked_by = number(a, P_ONE_WAY_BRAKE) * pick(held, all(1), pick(back_emf > 0, moves, all(0)));
  braked_by = pick(told < 0, 1 - (1 - braked_by) * (1 - number(a, P_ONE_WAY_REVERSE)), all(0));
  V driving = pick(along >= 0, number(a, P_ONE_WAY) * stopped, all(0));
  V switched = braked_by * (back * (1 - shorted) - along) + (1 - braked_by) * driving;
  return told + way * (idle * number(a, P_ONE_WAY_NEUTRAL) * stopped + (1 - idle) * switched);
}

// One control period of LANES cars: `count` steps with the commands held; force: x, y [N] and moment [N m] on the body
// at the CG, in the body frame of the period's beginning, or NULL.
static void drive_lanes(const Cars* a, V command, V steering, const V force[3], int count, V out[N_SIGNAL]) {
  const double *C = a->C, h = C[C_STEP], hc = C[C_ORIGIN_HEIGHT], radius = C[C_ROLLING_RADIUS], gear = C[C_GEAR];
  const V wheel_spin = number(a, P_WHEEL_INERTIA);
  const V wheels = 4 * wheel_spin * gear;  // spin of the wheels per motor speed
  // mean wheel speeds are gear * motor + ahead * centre in front and gear * motor - behind * centre in the rear
  const double ahead = C[C_FRONT_SHARE], behind = C[C_REAR_SHARE];
  const V apart = 2 * wheel_spin * (ahead - behind);  // spin of the wheels per `centre`
  const V spun = 2 * wheel_spin * (ahead * ahead + behind * behind);
  command = clip(command, all(C[C_MAX_COMMAND]));
  steering = clip(steering, all(C[C_MAX_STEERING]));
  V x = state(a, S_X), y = state(a, S_Y), yaw = state(a, S_YAW), c = state(a, S_COSINE), s = state(a, S_SINE);
  V norm = 1.5 - .5 * (c * c + s * s);
  c *= norm, s *= norm;
  Pair v = {state(a, S_VELOCITY_X), state(a, S_VELOCITY_Y)}, pushed = {all(0), all(0)}, felt = pushed;
  V yaw_rate = state(a, S_YAW_RATE), roll = state(a, S_ROLL), pitch = state(a, S_PITCH), heave = state(a, S_HEAVE);
  V roll_rate = state(a, S_ROLL_RATE), pitch_rate = state(a, S_PITCH_RATE), heave_rate = state(a, S_HEAVE_RATE);
  V motor = state(a, S_MOTOR), front = state(a, S_FRONT_DIFFERENCE), rear = state(a, S_REAR_DIFFERENCE);
  V centre = state(a, S_CENTRE_DIFFERENCE);
  V servo = state(a, S_SERVO), servo_before = state(a, S_SERVO_BEFORE), servo_rate = state(a, S_SERVO_RATE);
  V moment = all(0);
  if (force) pushed = turned((Pair){force[0], force[1]}, s, c), moment = force[2];
  const Pair gravity = {number(a, P_GRAVITY_X), number(a, P_GRAVITY_Y)};
  const V m = number(a, P_MASS), mx = number(a, P_MOMENT_X), my = number(a, P_MOMENT_Y), mz = number(a, P_MOMENT_Z);
  const V iyr = number(a, P_YAW_ROLL_INERTIA), iyp = number(a, P_YAW_PITCH_INERTIA), iy = number(a, P_YAW_INERTIA);
  const V ir = number(a, P_ROLL_INERTIA), ip = number(a, P_PITCH_INERTIA), im = number(a, P_SPINNING_INERTIA);
  const V sx = number(a, P_SPRUNG_X), sy = number(a, P_SPRUNG_Y), sz = number(a, P_SPRUNG_Z);
  const V curve = number(a, P_ACKERMANN), sa = number(a, P_SERVO_A), sb = number(a, P_SERVO_B);
  const V sc = number(a, P_SERVO_C), sd = number(a, P_SERVO_D), stop = all(C[C_MAX_STEERING]);
  const V servo_step = number(a, P_SERVO_STEP), servo_most = number(a, P_SERVO_MOST);
  const V viscous = number(a, P_DIFFERENTIAL_DAMPING), coulomb = number(a, P_DIFFERENTIAL_FRICTION);
  const V between = number(a, P_CENTRE_DAMPING);
  // what acts for the first `hold` of the period, and for the rest
  const Held angle_told = held(a, S_TOLD, P_STEERING_HOLD, steering), drive_told = held(a, S_DRIVEN, P_DRIVE_HOLD, command);

  V braked = state(a, S_BRAKED);
  braked = pick(braked == braked, braked, number(a, P_BRAKED_AT_FIRST));
  const V emf = number(a, P_MOTOR_DAMPING) / number(a, P_TORQUE_PER_COMMAND);

  Fixed fixed;
  WHEELS {
    fixed.by_rim_mass[k] = 1 / number(a, P_RIM_MASS + k), fixed.by_shape[k] = 1 / number(a, P_TYRE_SHAPE + k);
    fixed.damping[k] = C[C_CARCASS_DAMPING] / number(a, P_CORNERING_STIFFNESS + k);
  }

  for (int n = 0; n < count; n++) {
    V half = .5 * h * yaw_rate, dc = cosine_series(half, 6), ds = sine_series(half, 7);
    V cm = c * dc - s * ds, sm = s * dc + c * ds;  // heading of the middle of the step
    Pair now = turned(v, -sm, cm), before = turned(v, -s, c);
    Suspension springs;
    suspend(a, roll, pitch, heave, roll_rate, pitch_rate, heave_rate, &springs);

    Tyres t = {0};
    Wheel wheel[4];
    V way = servo - servo_before, bend = curve * servo * servo, bending = bend - curve * servo_before * servo_before;
    Motion motion[4];
    UNROLLED for (int k = 0; k < 2; k++) {
      V angle = servo + side_of(k) * bend, step = way + side_of(k) * bending;
      V st = sine_series(angle, 15), ct = cosine_series(angle, 16), d1 = .5 * step, s1 = sine_series(d1, 5), c1 = cosine_series(d1, 6);
      V speed = gear * motor + ahead * centre + .5 * side_of(k) * front;
      motion[k] = (Motion){speed, st, ct, st * c1 + ct * s1, ct * c1 - st * s1, half + d1};
    }
    UNROLLED for (int k = 2; k < 4; k++) {
      V speed = gear * motor - behind * centre + .5 * side_of(k) * rear;
      motion[k] = (Motion){speed, all(0), all(1), all(0), all(1), half};
    }
    roll_wheels(a, now, before, yaw_rate, roll_rate, pitch_rate, motion, &fixed, springs.load, wheel, &t);

    // inertia of car, wheels and motor, and the tyres': patches move with hc times roll rate to the left
    V A[AT(N_UNKNOWN - 1, N_UNKNOWN)], b[N_UNKNOWN];
    const V* T = t.plane;
    A[AT(VX, VX)] = m + T[0];
    A[AT(VY, VX)] = T[1];
    A[AT(VY, VY)] = m + T[2];
    A[AT(YAW, VX)] = T[3] - my;
    A[AT(YAW, VY)] = T[4] + mx;
    A[AT(YAW, YAW)] = T[5] + iy;
    A[AT(ROLL, VX)] = hc * T[1];
    A[AT(ROLL, VY)] = hc * T[2] - mz;
    A[AT(ROLL, YAW)] = hc * T[4] + iyr;
    A[AT(ROLL, ROLL)] = hc * hc * T[2] + ir;
    A[AT(PITCH, VX)] = mz - hc * T[0];
    A[AT(PITCH, VY)] = -hc * T[1];
    A[AT(PITCH, YAW)] = iyp - hc * T[3];
    A[AT(PITCH, ROLL)] = -hc * hc * T[1];
    A[AT(PITCH, PITCH)] = hc * hc * T[0] + ip;
    for (int axle = 0; axle < 2; axle++) {
      int row = FRONT + axle;
      const V* G = t.plane_axle[axle];
      V slip = absolute(axle ? rear : front);
      const double driven = C[axle ? C_REAR_DRIVEN : C_FRONT_DRIVEN];
      A[AT(row, VX)] = G[0], A[AT(row, VY)] = G[1], A[AT(row, YAW)] = G[2];
      A[AT(row, ROLL)] = hc * G[1], A[AT(row, PITCH)] = -hc * G[0];
      A[AT(row, row)] = t.axle[axle] + .5 * wheel_spin + h * driven * (viscous + coulomb / most(slip, all(SLOWEST_SLIDE)));
      A[AT(MOTOR, row)] = gear * t.mean_axle[axle];
      A[AT(CENTRE, row)] = (axle ? -behind : ahead) * t.mean_axle[axle];
      b[row] = .5 * wheel_spin * (axle ? rear : front) + t.to_axle[axle];
    }
    A[AT(REAR, FRONT)] = all(0);
    for (int i = 0; i < 3; i++) {
      A[AT(CENTRE, i)] = ahead * t.plane_mean[0][i] - behind * t.plane_mean[1][i];
      A[AT(MOTOR, i)] = gear * (t.plane_mean[0][i] + t.plane_mean[1][i]);
    }
    A[AT(CENTRE, ROLL)] = hc * A[AT(CENTRE, VY)], A[AT(CENTRE, PITCH)] = apart - hc * A[AT(CENTRE, VX)];
    A[AT(CENTRE, CENTRE)] = ahead * ahead * t.mean[0] + behind * behind * t.mean[1] + spun + h * between;
    A[AT(MOTOR, ROLL)] = hc * A[AT(MOTOR, VY)], A[AT(MOTOR, PITCH)] = wheels - hc * A[AT(MOTOR, VX)];
    A[AT(MOTOR, CENTRE)] = gear * (ahead * t.mean[0] - behind * t.mean[1] + apart);
    A[AT(MOTOR, MOTOR)] = gear * gear * (t.mean[0] + t.mean[1]) + im;

    // momentum now, and the impulses that don't depend on the end: centrifugal and gyroscopic ones among them
    Pair f = turned(pushed, -sm, cm), g = turned(gravity, -sm, cm);
    V spin2 = yaw_rate * yaw_rate, off = servo - angle_told.newer, off_older = servo - angle_told.older;
    V still = still_older(&angle_told, n, count), volts_still = still_older(&drive_told, n, count);
    V next_way = (1 - still) * clip(clip(angle_told.newer + sa * off + sb * servo_rate, stop) - servo, servo_step) +
                 still * clip(clip(angle_told.older + sa * off_older + sb * servo_rate, stop) - servo, servo_step);
    V newer = drive_told.newer, older = drive_told.older;
    if (C[C_DUTY_SUPPLY] > 0) {
      V back_emf = emf * motor, then = braked;
      newer = controlled(a, newer, back_emf, &braked), older = controlled(a, older, back_emf, &then);
      braked = pick(volts_still < .5, braked, then);
    }
    V driven = (1 - volts_still) * newer + volts_still * older;
    V drawn = driven * number(a, P_TORQUE_PER_COMMAND) - number(a, P_MOTOR_DAMPING) * motor;
    V torque = clip(drawn / (1 + number(a, P_SUPPLY_SAG) * driven * driven), number(a, P_MAX_TORQUE));
    b[VX] = m * now.x - my * yaw_rate + mz * pitch_rate + h * (f.x + m * g.x + spin2 * mx) + t.to_plane[0];
    b[VY] = m * now.y + mx * yaw_rate - mz * roll_rate + h * (f.y + m * g.y + spin2 * my) + t.to_plane[1];
    b[YAW] = mx * now.y - my * now.x + iy * yaw_rate + iyr * roll_rate + iyp * pitch_rate +
             h * (moment + sx * f.y - sy * f.x + mx * g.y - my * g.x) + t.to_plane[2] -
             C[C_KNUCKLE_INERTIA] / h * (next_way - way);
    b[ROLL] = -mz * now.y + iyr * yaw_rate + ir * roll_rate + hc * t.to_plane[1] +
              h * (-sz * f.y - mz * g.y + springs.about_x + springs.sum * (C[C_ROLL_ARM] + sz) * roll + spin2 * iyp +
                   (yaw_rate + .5 * way / h) * (wheels * motor + apart * centre));
    b[PITCH] = mz * now.x + iyp * yaw_rate + ip * pitch_rate + wheels * motor + apart * centre - hc * t.to_plane[0] +
               h * (sz * f.x + mz * g.x - springs.about_y + springs.sum * (C[C_PITCH_ARM] + sz) * pitch - spin2 * iyr);
    b[CENTRE] = spun * centre + apart * (gear * motor + pitch_rate) + ahead * t.to_mean[0] - behind * t.to_mean[1];
    b[MOTOR] = im * motor + wheels * pitch_rate + gear * apart * centre + gear * (t.to_mean[0] + t.to_mean[1]) +
               h * (torque - number(a, P_DRIVELINE_DAMPING) * motor);
    solve(A, b, h * number(a, P_DRIVELINE_FRICTION));

    WHEELS {
      const Wheel* w = wheel + k;
      V ux = b[VX] - hc * b[PITCH], uy = b[VY] + hc * b[ROLL];
      V axle = k < 2 ? ahead * b[CENTRE] : -behind * b[CENTRE];
      V rim = radius * (gear * b[MOTOR] + axle + .5 * side_of(k) * b[k < 2 ? FRONT : REAR]);
      V vx = w->along[0] * ux + w->along[1] * uy + w->along[2] * b[YAW] - rim + w->turning.x;
      V vy = w->across[0] * ux + w->across[1] * uy + w->across[2] * b[YAW] + w->turning.y;
      V rise = state(a, S_RISE + k) + h * (springs.load[k] * (1 / C[C_WHEEL_MASS]) - springs.acceleration[k]);
      put(a, S_SLIP_X + k, w->kept.x + w->gain.x * vx);
      put(a, S_SLIP_Y + k, w->kept.y + w->gain.y * vy);
      put(a, S_LOAD + k, springs.load[k]);
      put(a, S_RISE + k, rise);
      put(a, S_HEIGHT + k, state(a, S_HEIGHT + k) + h * rise);
    }
    Pair next = turned((Pair){b[VX], b[VY]}, sm, cm);
    if (n == count - 1) {  // what an accelerometer shows in this step, in its frame of the step's beginning
      Pair pull = turned((Pair){(next.x - v.x) * (1 / h) - gravity.x, (next.y - v.y) * (1 / h) - gravity.y}, -s, c);
      V turning = (b[YAW] - yaw_rate) * (1 / h), lever = C[C_IMU_X] + number(a, P_CG_SHIFT);
      felt.x = pull.x - turning * C[C_IMU_Y] - spin2 * lever - C[C_GRAVITY] * pitch;
      felt.y = pull.y + turning * lever - spin2 * C[C_IMU_Y] + C[C_GRAVITY] * roll;
    }
    v = next;
    yaw_rate = b[YAW], roll_rate = b[ROLL], pitch_rate = b[PITCH], front = b[FRONT], rear = b[REAR], motor = b[MOTOR];
    centre = b[CENTRE];
    heave_rate += h * (springs.sum / number(a, P_SPRUNG_MASS) - C[C_GRAVITY]);
    x += h * v.x, y += h * v.y, yaw += h * yaw_rate;
    roll += h * roll_rate, pitch += h * pitch_rate, heave += h * heave_rate;
    V angle = h * yaw_rate;
    Pair heading = turned((Pair){c, s}, sine_series(angle, 7), cosine_series(angle, 8));
    c = heading.x, s = heading.y;
    servo_before = servo;
    servo += next_way;
    servo_rate = (1 - still) * clip(sc * off + sd * servo_rate, servo_most) +
                 still * clip(sc * off_older + sd * servo_rate, servo_most);
  }

  put(a, S_X, x), put(a, S_Y, y), put(a, S_YAW, yaw), put(a, S_COSINE, c), put(a, S_SINE, s);
  put(a, S_VELOCITY_X, v.x), put(a, S_VELOCITY_Y, v.y), put(a, S_YAW_RATE, yaw_rate);
  put(a, S_ROLL, roll), put(a, S_PITCH, pitch), put(a, S_HEAVE, heave);
  put(a, S_ROLL_RATE, roll_rate), put(a, S_PITCH_RATE, pitch_rate), put(a, S_HEAVE_RATE, heave_rate);
  put(a, S_MOTOR, motor), put(a, S_FRONT_DIFFERENCE, front), put(a, S_REAR_DIFFERENCE, rear);
  put(a, S_CENTRE_DIFFERENCE, centre);
  put(a, S_SERVO, servo), put(a, S_SERVO_BEFORE, servo_before), put(a, S_SERVO_RATE, servo_rate);
  put(a, S_TOLD_BEFORE, state(a, S_TOLD)), put(a, S_TOLD, steering);
  put(a, S_DRIVEN_BEFORE, state(a, S_DRIVEN)), put(a, S_DRIVEN, command), put(a, S_BRAKED, braked);
  // as twin.py reads an accelerometer that spoke a step ago
  V half = .5 * h * yaw_rate;
  Pair body = turned(v, -s, c);
  out[0] = x, out[1] = y, out[2] = yaw, out[3] = body.x, out[4] = body.y, out[5] = yaw_rate;
  out[6] = felt.x + half * felt.y, out[7] = felt.y - half * felt.x, out[8] = motor, out[9] = servo;
  for (int i = 0; i < N_SIGNAL; i++) out[i] = pick(absolute(out[i]) < FLOWN_APART, out[i], all(NAN));
}

INLINE V gather(const double* values, long car, long size, long width) {
  V v;
  for (int l = 0; l < LANES; l++) v[l] = values[(car + l < size ? car + l : size - 1) * width];
  return v;
}

INLINE void scatter(const V out[N_SIGNAL], double* signals, long row, long lane) {
  for (int i = 0; i < N_SIGNAL; i++) signals[row * N_SIGNAL + i] = out[i][lane];
}

// How many cars a block has.
long lanes(void) { return LANES; }

// One control period of `count` blocks of LANES cars. commands (size, 2), force (size, 3) or NULL, signals (size, 10).
void advance(const double* C, const double* P, double* S, long stride, long size, const double* commands,
             const double* force, double* signals, int steps, const int64_t* blocks, long count) {
  for (long i = 0; i < count; i++) {
    long car = LANES * blocks[i];
    Cars a = {C, P + car, S + car, stride};
    V out[N_SIGNAL], push[3];
    for (int k = 0; k < 3; k++) push[k] = force ? gather(force + k, car, size, 3) : all(0);
    drive_lanes(&a, gather(commands, car, size, 2), gather(commands + 1, car, size, 2), force ? push : 0, steps, out);
    for (long l = 0; l < LANES && car + l < size; l++) scatter(out, signals, car + l, l);
  }
}

// A force against the motion that grows with the square of the speed, x and y in the body frame: -drag |v| v.
INLINE Pair resisted(const Cars* a, V drag) {
  Pair v = turned((Pair){state(a, S_VELOCITY_X), state(a, S_VELOCITY_Y)}, -state(a, S_SINE), state(a, S_COSINE));
  V factor = -drag * root(v.x * v.x + v.y * v.y);
  return (Pair){factor * v.x, factor * v.y};
}

// What acts of a drive command on a motor with less flux and conductance, as shares of the cold one's.
INLINE V faded(const Cars* a, V command, V flux, V conductance) {
  V idle = number(a, P_MOTOR_DAMPING) / number(a, P_TORQUE_PER_COMMAND) * state(a, S_MOTOR);
  return idle + (command - idle * flux) * flux * conductance;
}

// Whole runs of `count` blocks of LANES cars from block `first`: commands (T, size, 2), periods to drive (size,),
// drag (size,), shares of flux and conductance (T, size, 2) or NULL, signals (size, T + 1, 10), of which row 0 is there;
// a car that has driven its periods keeps its last row.
void drive(const double* C, const double* P, double* S, long stride, long size, const double* commands, long T,
           const int64_t* periods, const double* drag, const double* weakened, double* signals, int steps, long first,
           long count) {
  for (long car = LANES * first; car < LANES * (first + count) && car < size; car += LANES) {
    Cars a = {C, P + car, S + car, stride};
    long longest = 0;
    for (long l = 0; l < LANES && car + l < size; l++) longest = periods[car + l] > longest ? periods[car + l] : longest;
    V resistance = gather(drag, car, size, 1);
    for (long k = 0; k < T; k++) {
      V out[N_SIGNAL];
      const double *now = commands + 2 * size * k, *share = weakened ? weakened + 2 * size * k : 0;
      if (k < longest) {
        V told = gather(now, car, size, 2);
        if (share) told = faded(&a, told, gather(share, car, size, 2), gather(share + 1, car, size, 2));
        Pair against = resisted(&a, resistance);
        V push[3] = {against.x, against.y, all(0)};
        drive_lanes(&a, told, gather(now + 1, car, size, 2), push, steps, out);
      }
      for (long l = 0; l < LANES && car + l < size; l++) {
        double* row = signals + ((car + l) * (T + 1) + k) * N_SIGNAL;
        if (k < periods[car + l]) scatter(out, row, 1, l);
        else __builtin_memcpy(row + N_SIGNAL, row, N_SIGNAL * sizeof(double));
      }
    }
  }
}
