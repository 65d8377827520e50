// The tyre of the car as a MuJoCo engine plugin: "qcar.tyre", passive capability.
//
// MuJoCo calls a passive plugin after the constraint rows are made and before their reference accelerations are.
// For every wheel on the ground the plugin turns the two friction rows of its contact into an implicit tyre: the
// rows then solve for  f = -c v(t+h) - b,  a law that is linear in the slip velocity at the end of the step, so the
// tyre is stable at any step and at standstill. The equations are in docs/reference/tyre.md.
//
// Directions: x where the wheel rolls (axle cross normal), y along the axle. Slip velocity is that of the rubber over
// the ground, force is that of the ground on the wheel and opposes it.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <mujoco/mujoco.h>

#include "laws.h"  // written by build.py: the places of geom_user (TAG, CORNERING_STIFFNESS, ...), `secant` of every law

// plugin_state of a wheel
enum { LOAD, SLIP_X, SLIP_Y, N_STATE };

#define UNSET -1.0           // LOAD before the first step: nominal load, steady slip
#define CREEP_SPEED 0.005    // m/s, added to the rolling speed so that slip is finite at standstill
#define DAMPED_SPEED 0.1     // m/s, carcass damping fades above it
#define LEAST_LOAD 0.02      // least load / nominal load seen by the tyre law
#define CONE_RESERVE 1.5     // the friction cone stands this far outside the tyre's own peak
#define GRAVITY 9.81         // m/s^2, of the load that a tyre is made for
#define LEAST_ALIGNMENT 0.7  // contact normal . chassis z: below, the wheel meets a wall

typedef struct {
  int geom, body, chassis, joint, dof;
  int base;                  // first of the three translations of the car as a whole, -1: it has none
  // of the present step
  int row;                   // first constraint row of the ground contact, -1: none
  mjtNum side;               // 1 if the contact normal points from ground to wheel, else -1
  mjtNum speed;              // reference speed of the slip, m/s
  mjtNum slip[2];            // transient slip at its beginning
  mjtNum turning[2];         // slip velocity at the end of the step that the rows don't see, m/s
  mjtNum sliding[2];         // slip velocity at its beginning, m/s
  mjtNum late[2];            // weight of its end
} Wheel;

typedef struct {
  int count;
  Wheel wheel[];
} Tyres;

// does this geom belong to the plugin instance: a tagged geom below the body that carries the instance
static int belongs(const mjModel* m, int geom, int instance) {
  if (m->geom_user[geom * m->nuser_geom + TAG] <= 0) return 0;
  for (int b = m->geom_bodyid[geom]; b > 0; b = m->body_parentid[b]) {
    if (m->body_plugin[b] == instance) return 1;
  }
  return 0;
}

static int count_wheels(const mjModel* m, int instance) {
  int count = 0;
  if (m->nuser_geom < N_PARAMETER) return 0;
  for (int g = 0; g < m->ngeom; g++) count += belongs(m, g, instance);
  return count;
}

static int tyre_nstate(const mjModel* m, int instance) { return N_STATE * count_wheels(m, instance); }

static int tyre_init(const mjModel* m, mjData* d, int instance) {
  int count = count_wheels(m, instance);
  if (!count) {
    mju_warning("qcar.tyre: no geom with user data below the body that carries the plugin instance");
    return -1;
  }
  Tyres* tyres = calloc(1, sizeof(Tyres) + count * sizeof(Wheel));
  if (!tyres) return -1;
  for (int g = 0; g < m->ngeom; g++) {
    if (!belongs(m, g, instance)) continue;
    Wheel* w = tyres->wheel + tyres->count++;
    int body = m->geom_bodyid[g];
    int joint = m->body_jntadr[body] + m->body_jntnum[body] - 1;
    if (m->body_jntnum[body] < 1 || m->jnt_type[joint] != mjJNT_HINGE) {
      mju_warning("qcar.tyre: the last joint of a wheel body must be the hinge it spins on");
      free(tyres);
      return -1;
    }
    w->geom = g;
    w->body = body;
    w->chassis = m->body_parentid[body];
    w->joint = joint;
    w->dof = m->jnt_dofadr[joint];
    w->row = -1;
    int root = m->body_rootid[body], first = m->body_jntadr[root];
    w->base = m->body_jntnum[root] && m->jnt_type[first] == mjJNT_FREE ? m->jnt_dofadr[first] : -1;
  }
  d->plugin_data[instance] = (uintptr_t)tyres;
  return 0;
}

static void tyre_destroy(mjData* d, int instance) {
  free((void*)d->plugin_data[instance]);
  d->plugin_data[instance] = 0;
}

static void tyre_copy(mjData* dest, const mjModel* m, const mjData* src, int instance) {
  const Tyres* from = (const Tyres*)src->plugin_data[instance];
  memcpy((void*)dest->plugin_data[instance], from, sizeof(Tyres) + from->count * sizeof(Wheel));
}

static void tyre_reset(const mjModel* m, mjtNum* state, void* data, int instance) {
  int n = m->plugin_statenum[instance];
  for (int i = 0; i < n; i += N_STATE) {
    state[i + LOAD] = UNSET;
    state[i + SLIP_X] = state[i + SLIP_Y] = 0;
  }
}

// values of one Jacobian row and their count; dof[] is NULL for a dense row
static int jacobian_row(const mjModel* m, const mjData* d, int row, mjtNum** value, const int** dof) {
  if (mj_isSparse(m)) {
    *value = d->efc_J + d->efc_J_rowadr[row];
    *dof = d->efc_J_colind + d->efc_J_rowadr[row];
    return d->efc_J_rownnz[row];
  }
  *value = d->efc_J + (size_t)row * m->nv;
  *dof = NULL;
  return m->nv;
}

// Point the two tangential rows along x and y, and their share of the base's translation along `mid`, the direction
// of x in the middle of the step. Doing it twice does no harm.
static void align(const mjModel* m, mjData* d, const Wheel* w, mjContact* contact, const mjtNum x[3],
                  const mjtNum mid[3]) {
  mjtNum *t1 = contact->frame + 3, *t2 = contact->frame + 6, across[3];
  mjtNum c = w->side * mju_dot3(x, t1), s = w->side * mju_dot3(x, t2);
  mjtNum *j1, *j2;
  const int* dof;
  int n = jacobian_row(m, d, w->row + 1, &j1, &dof);
  jacobian_row(m, d, w->row + 2, &j2, &dof);
  mju_cross(across, contact->frame, mid);  // side * y
  for (int i = 0; i < n; i++) {
    mjtNum a = j1[i], b = j2[i];
    int base = (dof ? dof[i] : i) - w->base;
    int translates = w->base >= 0 && base >= 0 && base < 3;
    j1[i] = translates ? mid[base] : c * a + s * b;
    j2[i] = translates ? across[base] : c * b - s * a;
  }
  for (int i = 0; i < 3; i++) {
    mjtNum a = t1[i], b = t2[i];
    t1[i] = c * a + s * b;
    t2[i] = c * b - s * a;
  }
}

// the two tangential rows times qvel, in wheel directions
static void row_velocity(const mjModel* m, const mjData* d, const Wheel* w, mjtNum v[2]) {
  for (int k = 0; k < 2; k++) {
    mjtNum *value, sum = 0;
    const int* dof;
    int n = jacobian_row(m, d, w->row + 1 + k, &value, &dof);
    for (int i = 0; i < n; i++) sum += value[i] * d->qvel[dof ? dof[i] : i];
    v[k] = k ? w->side * sum : sum;
  }
}

// Slip velocity now, and rolling speed as the result. A force that keeps its direction in the car turns with the car,
// so over a step the car as a whole is pushed along the heading of the step's middle; `turning` is what that heading
// has still to turn until the end of the step.
static mjtNum slip_velocity(const mjModel* m, mjData* d, Wheel* w, mjContact* contact, mjtNum v[2]) {
  const mjtNum *axle = d->xaxis + 3 * w->joint, *base = d->qvel + w->base;
  mjtNum up[3], x[3], y[3], arm[3], rim[3], mid[3], rate = d->qvel[w->dof];
  mju_scl3(up, contact->frame, w->side);
  mju_cross(x, axle, up);
  mju_normalize3(x);
  mju_cross(y, up, x);
  mjtNum turn = mju_dot3(d->cvel + 6 * w->body, up) - rate * mju_dot3(axle, up);
  mjtNum half = w->base < 0 ? 0 : 0.5 * m->opt.timestep * turn;
  mju_addScl3(mid, x, y, half);
  mju_normalize3(mid);
  align(m, d, w, contact, x, mid);
  row_velocity(m, d, w, v);
  w->turning[0] = w->base < 0 ? 0 : half * mju_dot3(base, y);
  w->turning[1] = w->base < 0 ? 0 : -half * mju_dot3(base, x);
  v[0] -= w->turning[0];
  v[1] -= w->turning[1];
  mju_sub3(arm, contact->pos, d->geom_xpos + 3 * w->geom);
  mju_cross(rim, axle, arm);
  return -rate * mju_dot3(rim, x);
}

// write  f = -c v(t+h) - b  into one friction row
static void write_row(mjData* d, int row, mjtNum h, mjtNum c, mjtNum b) {
  mjtNum R = 1 / (h * c);
  mjtNum* kbip = d->efc_KBIP + 4 * row;
  kbip[0] = 1;
  kbip[1] = 1 / h;
  kbip[2] = 1;
  d->efc_margin[row] = 0;
  d->efc_pos[row] = b * R;
  d->efc_R[row] = R;
  d->efc_D[row] = h * c;
}

// Weight of a step's end, 1/2 to 1: of second order where the step follows how a tyre and the mass m that it moves come to
// rest, s z'' + w z' + (C / m) z = 0, and backward Euler where it doesn't. (3 + x) / (6 + x) goes with the
// exponentially fitted 1 / (1 - exp(-x)) - 1 / x of Liniger and Willoughby (1970) at both ends, at most 0.09 below it
// between them; x = h times the slower rate. Across m is the load's, along what turns with the wheel.
static mjtNum lateness(mjtNum h, mjtNum length, mjtNum speed, mjtNum rate) {
  mjtNum slow = 2 * rate / (speed + sqrt(mju_max(speed * speed - 4 * length * rate, 0)));
  mjtNum x = h * mju_min(slow, sqrt(rate / mju_max(length, 1e-12)));
  return 1 - 3 / (6 + x);
}

// one wheel on the ground: the tyre law, its secant, the implicit rows
static void tyre_rows(const mjModel* m, mjData* d, Wheel* w, mjContact* contact, const mjtNum* state) {
  const mjtNum* u = m->geom_user + (size_t)w->geom * m->nuser_geom;
  mjtNum v[2], h = m->opt.timestep, rolling = slip_velocity(m, d, w, contact, v);

  // load, and what falls with it
  mjtNum nominal = u[NOMINAL_LOAD], unset = state[LOAD] < 0;
  mjtNum load = unset ? nominal : mju_max(state[LOAD], LEAST_LOAD * nominal);
  mjtNum fall = u[LOAD_EXPONENT] ? pow(load / nominal, -u[LOAD_EXPONENT]) : 1;
  mjtNum Cx = u[LONGITUDINAL_STIFFNESS] * fall * load / nominal;
  mjtNum Cy = u[CORNERING_STIFFNESS] * fall * load / nominal;
  mjtNum friction = u[FRICTION_COEFFICIENT] * fall;

  // Transient slip z, steady v / speed. In the step it is keep z + g v with `late` of the slip velocity of its end and the
  // rest of that of now; predicted with the velocity of now.
  mjtNum speed = sqrt(rolling * rolling + v[0] * v[0] + v[1] * v[1] + CREEP_SPEED * CREEP_SPEED);
  mjtNum lx = u[LONGITUDINAL_RELAXATION], late_x = lateness(h, lx, speed, Cx / mju_max(u[RIM_MASS], 1e-9));
  mjtNum ly = u[RELAXATION_LENGTH], late_y = lateness(h, ly, speed, Cy * GRAVITY / nominal);
  mjtNum tx = lx + h * late_x * speed, gx = h * late_x / tx, keep_x = lx / tx;
  mjtNum ty = ly + h * late_y * speed, gy = h * late_y / ty, keep_y = ly / ty;
  mjtNum zx = unset ? v[0] / speed : state[SLIP_X], zy = unset ? v[1] / speed : state[SLIP_Y];
  mjtNum px = Cx * (keep_x * zx + gx * v[0]), py = Cy * (keep_y * zy + gy * v[1]);
  mjtNum g = secant(u, sqrt(px * px + py * py) / (friction * load));

  // carcass damping acts on the rate of deflection, s dz/dt = v - speed z, and fades with speed
  mjtNum fade = DAMPED_SPEED * DAMPED_SPEED / (DAMPED_SPEED * DAMPED_SPEED + rolling * rolling);
  mjtNum damping = u[CARCASS_DAMPING] / u[CORNERING_STIFFNESS] * fade * fade, firm = g - damping * speed;
  mjtNum pull_x = Cx * (firm * gx + damping), pull_y = Cy * (firm * gy + damping), cx = pull_x * late_x, cy = pull_y * late_y;
  mjtNum held_x = Cx * firm * keep_x * zx + pull_x * (1 - late_x) * v[0];
  mjtNum held_y = Cy * firm * keep_y * zy + pull_y * (1 - late_y) * v[1];
  write_row(d, w->row + 1, h, cx, held_x + cx * w->turning[0]);
  write_row(d, w->row + 2, h, cy, w->side * (held_y + cy * w->turning[1]));

  // the elliptic cone ties R and friction of the two rows together; it stands outside the tyre's own peak
  mjtNum ratio = sqrt(cy / cx);
  contact->friction[0] = CONE_RESERVE * friction * mju_max(1, 1 / ratio);
  contact->friction[1] = contact->friction[0] * ratio;
  contact->mu = contact->friction[0] * sqrt(d->efc_R[w->row + 1] / d->efc_R[w->row]);
  w->speed = speed;
  w->slip[0] = zx;
  w->slip[1] = zy;
  w->sliding[0] = v[0];
  w->sliding[1] = v[1];
  w->late[0] = late_x;
  w->late[1] = late_y;
}

// 1 or -1 for the contact a wheel stands on, the direction of its normal; 0 for any other
static mjtNum stands(const mjData* d, const Wheel* w, const mjContact* contact) {
  if (contact->efc_address < 0 || contact->dim != 3) return 0;
  mjtNum side = contact->geom[1] == w->geom ? 1 : contact->geom[0] == w->geom ? -1 : 0;
  if (side == 0) return 0;
  const mjtNum *X = d->xmat + 9 * w->chassis, *n = contact->frame;
  return side * (n[0] * X[2] + n[1] * X[5] + n[2] * X[8]) > LEAST_ALIGNMENT ? side : 0;
}

static void tyre_compute(const mjModel* m, mjData* d, int instance, int capability) {
  Tyres* tyres = (Tyres*)d->plugin_data[instance];
  const mjtNum* state = d->plugin_state + m->plugin_stateadr[instance];
  for (int k = 0; k < tyres->count; k++) {
    Wheel* w = tyres->wheel + k;
    mjContact* deepest = NULL;
    for (int i = 0; i < d->ncon; i++) {
      mjContact* contact = d->contact + i;
      mjtNum side = stands(d, w, contact);
      if (side == 0 || (deepest && contact->dist >= deepest->dist)) continue;
      deepest = contact;
      w->side = side;
    }
    w->row = deepest ? deepest->efc_address : -1;
    if (deepest) tyre_rows(m, d, w, deepest, state + N_STATE * k);
  }
}

static void tyre_advance(const mjModel* m, mjData* d, int instance) {
  Tyres* tyres = (Tyres*)d->plugin_data[instance];
  mjtNum* state = d->plugin_state + m->plugin_stateadr[instance];
  mjtNum h = m->opt.timestep;
  for (int k = 0; k < tyres->count; k++, state += N_STATE) {
    const Wheel* w = tyres->wheel + k;
    if (w->row < 0) {
      state[LOAD] = state[SLIP_X] = state[SLIP_Y] = 0;
      continue;
    }
    const mjtNum* u = m->geom_user + (size_t)w->geom * m->nuser_geom;
    mjtNum v[2], length[2] = {u[LONGITUDINAL_RELAXATION], u[RELAXATION_LENGTH]};
    row_velocity(m, d, w, v);  // qvel is already that of the end of the step
    for (int i = 0; i < 2; i++) {
      mjtNum end = h * w->late[i], now = h - end, moved = now * w->sliding[i] + end * (v[i] + w->turning[i]);
      state[SLIP_X + i] = ((length[i] - now * w->speed) * w->slip[i] + moved) / (length[i] + end * w->speed);
    }
    state[LOAD] = d->efc_force[w->row];
  }
}

mjPLUGIN_LIB_INIT(qcar_tyre) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "qcar.tyre";
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nstate = tyre_nstate;
  plugin.init = tyre_init;
  plugin.destroy = tyre_destroy;
  plugin.copy = tyre_copy;
  plugin.reset = tyre_reset;
  plugin.compute = tyre_compute;
  plugin.advance = tyre_advance;
  mjp_registerPlugin(&plugin);
}
