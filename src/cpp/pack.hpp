// A pack of LANES doubles, one triangle per lane, on the compiler's own vector types.
// Compiled once per instruction set (CMakeLists.txt): VOILE_LANES lanes, symbols in namespace voile::VOILE_ISA.
#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#ifndef VOILE_LANES
#define VOILE_LANES 2
#define VOILE_ISA baseline
#endif

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

template <class F>
inline Real lanewise(const Real& a, F f) {
  Real r;
  for (int i = 0; i < LANES; ++i) r.p[i] = f(a.p[i]);
  return r;
}
inline Real sqrt(const Real& a) {
  return lanewise(a, [](double x) { return std::sqrt(x); });
}
inline Real log(const Real& a) {
  return lanewise(a, [](double x) { return std::log(x); });
}
inline Real angle(const Real& s, const Real& c) {
  Real r;
  for (int i = 0; i < LANES; ++i) r.p[i] = std::atan2(s.p[i], c.p[i]);
  return r;
}
inline Real value(const Real& a) { return a; }
inline void set_value(Real& a, const Real& value) { a = value; }
inline Real select(const Mask& mask, const Real& a, const Real& b) { return Real(mask ? a.p : b.p); }
inline Real max(const Real& a, const Real& b) { return Real(a.p > b.p ? a.p : b.p); }

// A vector of three packs.
struct Vec3 {
  Real x, y, z;
};
inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(const Real& s, const Vec3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Real dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace VOILE_ISA
}  // namespace voile
