// Cars side by side in the lanes of vector registers, with the compiler's vector extension: wherever the processor has
// no such registers the same source becomes scalar code. Every operation is IEEE's own, so all of them give the same bits.

#include <math.h>
#include <stdint.h>

#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif
typedef double V __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES)));  // all bits of a lane, or none
#define UNROLLED _Pragma("GCC unroll 16")
#define INLINE static inline __attribute__((always_inline))

INLINE V all(double x) { return x - (V){0}; }
INLINE V load(const double* x) { V v; __builtin_memcpy(&v, x, sizeof v); return v; }
INLINE void store(double* x, V v) { __builtin_memcpy(x, &v, sizeof v); }
INLINE V pick(Mask m, V a, V b) { return (V)(((Mask)a & m) | ((Mask)b & ~m)); }  // m ? a : b
INLINE V least(V a, V b) { return pick(a < b, a, b); }
INLINE V most(V a, V b) { return pick(a > b, a, b); }
INLINE V clip(V x, V bound) { return most(least(x, bound), -bound); }
INLINE V absolute(V x) { return (V)((Mask)x & INT64_MAX); }

INLINE V root(V x) {
  for (int l = 0; l < LANES; l++) x[l] = sqrt(x[l]);
  return x;
}

static const double BY_FACTORIAL[] = {  // 1 / n!
  1. / 1, 1. / 1, 1. / 2, 1. / 6, 1. / 24, 1. / 120, 1. / 720, 1. / 5040, 1. / 40320, 1. / 362880, 1. / 3628800,
  1. / 39916800, 1. / 479001600, 1. / 6227020800, 1. / 87178291200, 1. / 1307674368000, 1. / 20922789888000,
  1. / 355687428096000, 1. / 6402373705728000, 1. / 121645100408832000,
};

// x - x^3/3! + ... and 1 - x^2/2! + ..., up to x^last
INLINE V sine_series(V x, int last) {
  V q = x * x, s = all(BY_FACTORIAL[last]);
  UNROLLED for (int n = last - 2; n > 0; n -= 2) s = BY_FACTORIAL[n] - q * s;
  return x * s;
}

INLINE V cosine_series(V x, int last) {
  V q = x * x, s = all(BY_FACTORIAL[last]);
  UNROLLED for (int n = last - 2; n >= 0; n -= 2) s = BY_FACTORIAL[n] - q * s;
  return s;
}

// 0 <= x <= pi, to 1e-14
INLINE V sine(V x) { return sine_series(least(x, M_PI - x), 19); }

// x >= 0: atan x = k pi / 8 + atan u with |u| <= tan(pi / 8), and atan u by its series, to 1e-13
INLINE V arctangent(V x) {
  const double c = 0.41421356237309503;  // tan(pi / 8)
  Mask large = x > 1;
  V u = pick(large, c * x - 1, x - c) / pick(large, x + c, 1 + c * x), q = u * u, s = all(1. / 33);
  UNROLLED for (int n = 31; n > 0; n -= 2) s = 1. / n - q * s;
  return pick(large, all(3 * M_PI / 8), all(M_PI / 8)) + u * s;
}

#define WHOLE 6755399441055744.0  // 1.5 * 2^52: added to a double, its low bits are the nearest integer

// |x| < 700, to 1e-14
INLINE V exponential(V x) {
  V k = x * 1.4426950408889634 + WHOLE, f = x - (k - WHOLE) * 0.6931471805599453;
  V s = all(BY_FACTORIAL[12]);
  UNROLLED for (int n = 11; n >= 0; n--) s = BY_FACTORIAL[n] + f * s;
  return (V)((Mask)s + ((Mask)k << 52));
}

// x > 0, to 1e-14: exponent, and twice the area tangent of a mantissa between sqrt(1/2) and sqrt(2)
INLINE V logarithm(V x) {
  Mask bits = (Mask)x, high;
  V m = (V)((bits & 0xfffffffffffffLL) | 0x3ff0000000000000LL);
  high = m > M_SQRT2;
  V e = (V)((bits >> 52) + 0x4338000000000000LL - 1023) - WHOLE;
  e = pick(high, e + 1, e);
  m = pick(high, .5 * m, m);
  V u = (m - 1) / (m + 1), q = u * u, s = all(1. / 17);
  UNROLLED for (int n = 15; n > 0; n -= 2) s = 1. / n + q * s;
  return e * 0.6931471805599453 + 2 * u * s;
}
