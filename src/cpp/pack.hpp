// A pack of LANES doubles, one triangle per lane, on the compiler's own vector types.
// Compiled once per instruction set (CMakeLists.txt): VOILE_LANES lanes, symbols in namespace
// voile::VOILE_ISA.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>

#ifndef VOILE_LANES
#define VOILE_LANES 2
#define VOILE_ISA baseline
#endif

// For the small functions of the inner loops: packs passed by address would cost more than the work.
#define VOILE_INLINE inline __attribute__((always_inline))

namespace voile {
inline namespace VOILE_ISA {

constexpr int LANES = VOILE_LANES;
typedef double Pack __attribute__((vector_size(8 * VOILE_LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * VOILE_LANES)));

// A constructible wrapper so that packs can stand wherever a number does.
struct Real {
  Pack p;
  Real() = default;
  Real(double s) : p(Pack{} + s) {}
  Real(Pack v) : p(v) {}
  double operator[](int lane) const { return p[lane]; }
};

inline Real operator-(const Real& a) { return -a.p; }
inline Real operator+(const Real& a, const Real& b) { return a.p + b.p; }
inline Real operator-(const Real& a, const Real& b) { return a.p - b.p; }
inline Real operator*(const Real& a, const Real& b) { return a.p * b.p; }
inline Real operator/(const Real& a, const Real& b) { return a.p / b.p; }
inline Real& operator+=(Real& a, const Real& b) {
  a.p += b.p;
  return a;
}
inline Real& operator-=(Real& a, const Real& b) {
  a.p -= b.p;
  return a;
}

// The pack of f(0), f(1), ...: lanes gathered from memory without a detour over the stack.
template <class F, int... lane>
VOILE_INLINE Real gather(F f, std::integer_sequence<int, lane...>) {
  return Pack{f(lane)...};
}
template <class F>
VOILE_INLINE Real gather(F f) {
  return gather(f, std::make_integer_sequence<int, LANES>{});
}
// A pack kept in memory as floats (small constants: signs, halves).
inline Real widen(const float* v) {
  typedef float Narrow __attribute__((vector_size(4 * VOILE_LANES)));
  Narrow narrow;
  std::memcpy(&narrow, v, sizeof narrow);
  return Real(__builtin_convertvector(narrow, Pack));
}

template <class F>
inline Real lanewise(const Real& a, F f) {
  Real r;
  for (int i = 0; i < LANES; ++i) r.p[i] = f(a.p[i]);
  return r;
}
inline Real sqrt(const Real& a) {
  return lanewise(a, [](double x) { return std::sqrt(x); });
}
inline Real log1p(const Real& a) {
  return lanewise(a, [](double x) { return std::log1p(x); });
}
// x - log1p(x), by its series where the difference would cancel.
inline Real less_log1p(const Real& a) {
  return lanewise(a, [](double x) {
    if (!(std::fabs(x) < 0.01)) return x - std::log1p(x);
    double sum = 0.0;
    for (int k = 9; k > 1; --k)
      sum = 1.0 / k - x * sum;  // the first term left out is below a unit in the last place
    return x * x * sum;
  });
}
inline Real angle(const Real& s, const Real& c) {
  Real r;
  for (int i = 0; i < LANES; ++i) r.p[i] = std::atan2(s.p[i], c.p[i]);
  return r;
}
inline Real value(const Real& a) { return a; }
inline bool any(const Mask& mask) {
  int64_t found = 0;
  for (int i = 0; i < LANES; ++i) found |= mask[i];
  return found != 0;
}
inline void set_value(Real& a, const Real& value) { a = value; }
inline Real select(const Mask& mask, const Real& a, const Real& b) { return Real(mask ? a.p : b.p); }
inline Real max(const Real& a, const Real& b) { return Real(a.p > b.p ? a.p : b.p); }

// Sine and cosine: quadrant by Cody and Waite's three-part reduction, then fdlibm's polynomials on [-pi/4,
// pi/4] (s_sin.c, k_sin.c, k_cos.c; under one unit in the last place). Far outside, where the reduction loses
// digits, by lane.
VOILE_INLINE void sine_cosine(const Real& x, Real& s, Real& c) {
  if (any((x.p > 1e5) | (x.p < -1e5) | (x.p != x.p))) {
    s = lanewise(x, [](double v) { return std::sin(v); });
    c = lanewise(x, [](double v) { return std::cos(v); });
    return;
  }
  const Pack shifter = Pack{} + 0x1.8p52;  // adding it rounds to an integer in the low bits
  Pack shifted = x.p * 0x1.45f306dc9c883p-1 + shifter, n = shifted - shifter;
  Pack r = ((x.p - n * 0x1.921fb544p0) - n * 0x1.0b4611a6p-34) - n * 0x1.3198a2e037073p-69, z = r * r;
  Pack sine = r + r * z *
                      (-1.66666666666666324348e-01 +
                       z * (8.33333333332248946124e-03 +
                            z * (-1.98412698298579493134e-04 +
                                 z * (2.75573137070700676789e-06 +
                                      z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  Pack cosine =
      1.0 -
      (0.5 * z - z * z *
                     (4.16666666666666019037e-02 +
                      z * (-1.38888888888741095749e-03 +
                           z * (2.48015872894767294178e-05 +
                                z * (-2.75573143513906633035e-07 +
                                     z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))));
  Mask quadrant;
  std::memcpy(&quadrant, &shifted, sizeof quadrant);
  Mask odd = (quadrant & 1) != 0;
  s.p = odd ? cosine : sine, c.p = odd ? sine : cosine;
  s.p = (quadrant & 2) != 0 ? -s.p : s.p;
  c.p = ((quadrant + 1) & 2) != 0 ? -c.p : c.p;
}

// A vector of three packs.
struct Vec3 {
  Real x, y, z;
};
inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(const Real& s, const Vec3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Real dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 select(const Mask& mask, const Vec3& a, const Vec3& b) {
  return {select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z)};
}
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace VOILE_ISA
}  // namespace voile
