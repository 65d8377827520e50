// A Kalman filter over windows that whitens a residual together with the columns of a linear model.
//
// State: nx deviations of a window's start, nf forces that move them, and other coloured or constant errors; all but the
// first nx have unit stationary variance (the caller scales their columns). Equations: docs/likelihood.md.

#include <math.h>
#include <string.h>

#define MOST 24  // states

// Lower Cholesky factor in place; 0 where the matrix is not positive definite.
static int factor(double* a, long n) {
  for (long j = 0; j < n; j++) {
    for (long k = 0; k < j; k++) a[j * n + j] -= a[j * n + k] * a[j * n + k];
    if (!(a[j * n + j] > 0)) return 0;
    a[j * n + j] = sqrt(a[j * n + j]);
    for (long i = j + 1; i < n; i++) {
      for (long k = 0; k < j; k++) a[i * n + j] -= a[i * n + k] * a[j * n + k];
      a[i * n + j] /= a[j * n + j];
    }
  }
  return 1;
}

// L x = b for p right-hand sides (n, p), in place.
static void forward(const double* l, double* b, long n, long p) {
  for (long i = 0; i < n; i++) {
    double* row = b + i * p;
    for (long k = 0; k < i; k++) {
      double w = l[i * n + k];
      const double* other = b + k * p;
      for (long q = 0; q < p; q++) row[q] -= w * other[q];
    }
    double inverse = 1 / l[i * n + i];
    for (long q = 0; q < p; q++) row[q] *= inverse;
  }
}

// c (m, p) += s a (m, n) b (n, p), inner loops along rows
static void add_product(double* restrict c, const double* restrict a, const double* restrict b, long m, long n, long p,
                        double s) {
  for (long i = 0; i < m; i++)
    for (long k = 0; k < n; k++) {
      double w = s * a[i * n + k];
      if (w == 0) continue;
      for (long q = 0; q < p; q++) c[i * p + q] += w * b[k * p + q];
    }
}

static void transpose(double* restrict t, const double* restrict a, long n) {
  for (long i = 0; i < n; i++)
    for (long k = 0; k < n; k++) t[k * n + i] = a[i * n + k];
}

// Windows J, states n, of them nx motions and nf forces, p columns of which the first is the residual.
//   R (J, n, n): readings' slopes over the states after QR, unit noise.  Z (J, n, p): readings; whitened in place.
//   A (J, nx, nx + nf): ends over starts and forces.  G (J, nx, p): what each column adds to the next start.
//   begins (J): whether a chain begins.  keep (n - nx): memory of the other states over a window.
//   leak (nx): variance added to each motion per window.  prior (nx): of a chain's first start, whose mean is m0 (J, nx).
//   X, X0 (J, n), P, P0 (J, n, n): state and covariance after and before each window, or all NULL.
//   x (n, p): room for the states.
// Returns half the log determinant of the innovations' covariance, or NAN.
double whiten(long J, long n, long nx, long nf, long p, const double* R, double* Z, const double* A, const double* G,
              const unsigned char* begins, const double* keep, const double* leak, const double* prior, const double* m0,
              double* X, double* P, double* X0, double* P0, double* x) {
  double c[MOST * MOST], ph[MOST * MOST], s[MOST * MOST], f[MOST * MOST], t[MOST * MOST], half = 0;
  double* moved = x + n * p;
  for (long j = 0; j < J; j++) {
    if (begins[j]) {
      memset(x, 0, n * p * sizeof(double));
      memset(c, 0, sizeof c);
      for (long i = 0; i < n; i++) c[i * n + i] = i < nx ? prior[i] : 1;
      for (long i = 0; i < nx; i++) x[i * p] = m0[j * nx + i];
    }
    if (X0) {
      for (long i = 0; i < n; i++) X0[j * n + i] = x[i * p];
      memcpy(P0 + j * n * n, c, n * n * sizeof(double));
    }
    const double* h = R + j * n * n;
    double* z = Z + j * n * p;
    memset(ph, 0, sizeof ph);  // H P, whose transpose is P H'
    add_product(ph, h, c, n, n, n, 1);
    memset(s, 0, sizeof s);
    for (long i = 0; i < n; i++) s[i * n + i] = 1;
    transpose(t, h, n);
    add_product(s, ph, t, n, n, n, 1);
    if (!factor(s, n)) return NAN;
    for (long i = 0; i < n; i++) half += log(s[i * n + i]);
    add_product(z, h, x, n, n, p, -1);
    forward(s, z, n, p);
    forward(s, ph, n, n);
    for (long i = 0; i < n; i++)
      for (long k = 0; k < n; k++) {
        double w = ph[i * n + k];
        for (long q = 0; q < p; q++) x[k * p + q] += w * z[i * p + q];
        for (long q = 0; q < n; q++) c[k * n + q] -= w * ph[i * n + q];
      }
    if (X) {
      for (long i = 0; i < n; i++) X[j * n + i] = x[i * p];
      memcpy(P + j * n * n, c, n * n * sizeof(double));
    }
    memset(f, 0, sizeof f);
    for (long i = 0; i < nx; i++)
      for (long k = 0; k < nx + nf; k++) f[i * n + k] = A[(j * nx + i) * (nx + nf) + k];
    for (long i = nx; i < n; i++) f[i * n + i] = keep[i - nx];
    memset(moved, 0, n * p * sizeof(double));
    add_product(moved, f, x, n, n, p, 1);
    for (long i = 0; i < nx * p; i++) moved[i] += G[j * nx * p + i];
    memcpy(x, moved, n * p * sizeof(double));
    memset(t, 0, sizeof t);
    add_product(t, f, c, n, n, n, 1);
    transpose(ph, f, n);
    memset(c, 0, sizeof c);
    add_product(c, t, ph, n, n, n, 1);
    for (long i = 0; i < n; i++)
      for (long k = 0; k < i; k++) c[i * n + k] = c[k * n + i];
    for (long i = 0; i < n; i++) c[i * n + i] += i < nx ? leak[i] : 1 - keep[i - nx] * keep[i - nx];
  }
  return half;
}

// Smoothed means of the states (J, n) in place of X, which holds those after each window: Rauch, Tung and Striebel.
// Other arguments as of `whiten`; P and P0 are its covariances after and before each window, X0 its means before.
void smooth(long J, long n, long nx, long nf, const double* A, const unsigned char* begins, const double* keep, double* X,
            const double* P, const double* X0, const double* P0) {
  double ahead[MOST * MOST], f[MOST * MOST], g[MOST * MOST], unit[MOST], miss[MOST];
  for (long j = J - 2; j >= 0; j--) {
    if (begins[j + 1]) continue;
    const double* before = P0 + (j + 1) * n * n;
    for (long i = 0; i < n; i++) unit[i] = 1 / sqrt(before[i * n + i] + 1e-300);
    for (long i = 0; i < n; i++) {
      for (long k = 0; k < n; k++) ahead[i * n + k] = before[i * n + k] * unit[i] * unit[k];
      ahead[i * n + i] += 1e-12;
      miss[i] = (X[(j + 1) * n + i] - X0[(j + 1) * n + i]) * unit[i];
    }
    if (!factor(ahead, n)) continue;
    forward(ahead, miss, n, 1);
    for (long i = n - 1; i >= 0; i--) {
      for (long k = i + 1; k < n; k++) miss[i] -= ahead[k * n + i] * miss[k];
      miss[i] /= ahead[i * n + i];
    }
    memset(f, 0, sizeof f);
    for (long i = 0; i < nx; i++)
      for (long k = 0; k < nx + nf; k++) f[i * n + k] = A[(j * nx + i) * (nx + nf) + k] * unit[i];
    for (long i = nx; i < n; i++) f[i * n + i] = keep[i - nx] * unit[i];
    memset(g, 0, sizeof g);
    add_product(g, f, P + j * n * n, n, n, n, 1);
    for (long i = 0; i < n; i++)
      for (long k = 0; k < n; k++) X[j * n + k] += g[i * n + k] * miss[i];
  }
}
