// Forward-mode automatic differentiation: a value and N directional derivatives.
// Nest it (Dual<Dual<V, N>, M>) for second and mixed derivatives. V is a lane pack (pack.hpp).
#pragma once

#include "pack.hpp"

namespace voile {
inline namespace VOILE_ISA {

template <class T, int N>
struct Dual {
  T v;
  T d[N];

  Dual() = default;
  Dual(double value) : v(T(value)) {
    for (auto& di : d) di = T(0.0);
  }
  explicit Dual(const T& value)
    requires(!std::is_same_v<T, double>)
      : v(value) {
    for (auto& di : d) di = T(0.0);
  }
};

// A number as a constant of the type T.
template <class T>
inline T lift(const Real& v) {
  if constexpr (std::is_same_v<T, Real>)
    return v;
  else
    return T(lift<decltype(T::v)>(v));
}

// Chain rule for a function of one argument: value f, derivative f1.
template <class T, int N>
inline Dual<T, N> chain(const Dual<T, N>& x, const T& f, const T& f1) {
  Dual<T, N> y;
  y.v = f;
  for (int i = 0; i < N; ++i) y.d[i] = f1 * x.d[i];
  return y;
}

template <class T, int N>
inline Dual<T, N> operator-(const Dual<T, N>& a) {
  Dual<T, N> r;
  r.v = -a.v;
  for (int i = 0; i < N; ++i) r.d[i] = -a.d[i];
  return r;
}

template <class T, int N>
inline Dual<T, N> operator+(const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r;
  r.v = a.v + b.v;
  for (int i = 0; i < N; ++i) r.d[i] = a.d[i] + b.d[i];
  return r;
}

template <class T, int N>
inline Dual<T, N> operator-(const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r;
  r.v = a.v - b.v;
  for (int i = 0; i < N; ++i) r.d[i] = a.d[i] - b.d[i];
  return r;
}

template <class T, int N>
inline Dual<T, N> operator*(const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r;
  r.v = a.v * b.v;
  for (int i = 0; i < N; ++i) r.d[i] = a.v * b.d[i] + a.d[i] * b.v;
  return r;
}

template <class T, int N>
inline Dual<T, N> operator*(double s, const Dual<T, N>& a) {
  Dual<T, N> r;
  r.v = s * a.v;
  for (int i = 0; i < N; ++i) r.d[i] = s * a.d[i];
  return r;
}

template <class T, int N>
inline Dual<T, N> operator/(const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r;
  T inverse = T(1.0) / b.v;
  r.v = a.v * inverse;
  for (int i = 0; i < N; ++i) r.d[i] = (a.d[i] - r.v * b.d[i]) * inverse;
  return r;
}

template <class T, int N>
inline Dual<T, N> operator+(const Dual<T, N>& a, double s) {
  Dual<T, N> r = a;
  r.v = r.v + s;
  return r;
}

template <class T, int N>
inline Dual<T, N> operator-(const Dual<T, N>& a, double s) {
  return a + (-s);
}

template <class T, int N>
inline Dual<T, N> sqrt(const Dual<T, N>& a) {
  T s = sqrt(a.v);
  return chain(a, s, T(0.5 * (T(1.0) / s)));
}

template <class T, int N>
inline Dual<T, N> log1p(const Dual<T, N>& a) {
  return chain(a, log1p(a.v), T(T(1.0) / (a.v + T(1.0))));
}

// x - log1p(x)
template <class T, int N>
inline Dual<T, N> less_log1p(const Dual<T, N>& a) {
  return chain(a, less_log1p(a.v), T(a.v / (a.v + T(1.0))));
}

// The angle whose sine and cosine are s and c (not necessarily normalised); derivative (c ds - s
// dc)/(s^2+c^2).
template <class T, int N>
inline Dual<T, N> angle(const Dual<T, N>& s, const Dual<T, N>& c) {
  Dual<T, N> r;
  r.v = angle(s.v, c.v);
  T inverse = T(1.0) / (s.v * s.v + c.v * c.v);
  for (int i = 0; i < N; ++i) r.d[i] = (c.v * s.d[i] - s.v * c.d[i]) * inverse;
  return r;
}

template <class T, int N>
inline auto value(const Dual<T, N>& a) {
  return value(a.v);
}

// Replaces the innermost value (used where it is known more accurately than its own formula gives it).
template <class T, int N, class S>
inline void set_value(Dual<T, N>& a, const S& value) {
  set_value(a.v, value);
}

// a where the mask of lanes holds, else b.
template <class M, class T, int N>
inline Dual<T, N> select(const M& mask, const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r;
  r.v = select(mask, a.v, b.v);
  for (int i = 0; i < N; ++i) r.d[i] = select(mask, a.d[i], b.d[i]);
  return r;
}

}  // namespace VOILE_ISA
}  // namespace voile
