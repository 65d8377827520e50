// The sine law, F = mu F_z sin(C atan(rho / C)); see sine.py.

static inline mjtNum sine_secant(const mjtNum* u, mjtNum rho) {
  mjtNum C = u[TYRE_SHAPE];
  return rho < 1e-4 ? 1 : sin(C * atan(rho / C)) / rho;
}
