// The energy W of a triangle and its derivatives with respect to the six invariants, against a rest state.
#pragma once

#include "blocks.hpp"

namespace voile {
inline namespace VOILE_ISA {

constexpr int upper(int i, int j) { return i <= j ? i * 6 - i * (i - 1) / 2 + j - i : upper(j, i); }

// Value and derivatives of W with respect to l (0..2) and alpha (3..5).
struct Jet {
  Energy<Real> energy;
  Real g[6];
  Real h[21];
};

// Sums the triangles' energies; those without weight may hold anything.
struct Sum {
  Real stretching = 0.0, bending = 0.0;
  void add(const Jet& jet, const Real& weight) {
    auto counts = weight.p != 0.0;
    stretching += weight * select(counts, jet.energy.stretching, Real(0.0));
    bending += weight * select(counts, jet.energy.bending, Real(0.0));
  }
  void store(double* split) const {
    split[0] = split[1] = 0.0;
    for (int lane = 0; lane < LANES; ++lane) split[0] += stretching[lane], split[1] += bending[lane];
  }
};

// Rest invariants and fabric of a block of triangles.
struct Rest {
  Invariants<Real> q;
  Fabric<Real> fabric;
};

// What St. Venant-Kirchhoff needs of them. With t = tau.v and d the determinant of the form with components
// v, the stretching energy is major t^2 - minor d for v = dl, the bending energy ratio times that for v = II
// - II_rest.
struct QuadraticRest {
  Real height[3];      // twice the altitudes
  Sym2<Real> inverse;  // of the first form: what tau is made of
  Real major, minor, ratio;
};

// The same of any quadratic material: matrices (upper triangle 00 01 02 11 12 22) of twice the stretching
// energy in dl and of twice the bending energy in II - II_rest.
struct WovenRest {
  Real height[3];
  Real stretch[6], bend[6];
};
template <class Model>
using RestOf = std::conditional_t<Model::woven, WovenRest, QuadraticRest>;

template <int N>
inline Dual<Real, N> variable(const Real& v, int i) {
  Dual<Real, N> r(v);
  r.d[i] = 1.0;
  return r;
}

// The i-th of M outer variables (value v) and the i-th of N inner ones.
template <int N, int M>
inline Dual<Dual<Real, N>, M> variable2(const Real& v, int i) {
  Dual<Dual<Real, N>, M> r(variable<N>(v, i));
  r.d[i] = Dual<Real, N>(1.0);
  return r;
}

// Sine (or, shifted, cosine) of an angle variable: value, first derivative; the second is minus the value.
template <int N>
inline Dual<Real, N> wave(const Real& v, const Real& slope, int i) {
  Dual<Real, N> r(v);
  r.d[i] = slope;
  return r;
}

template <int N, int M>
inline Dual<Dual<Real, N>, M> wave2(const Real& v, const Real& slope, int i) {
  Dual<Dual<Real, N>, M> r(wave<N>(v, slope, i));
  r.d[i] = wave<N>(slope, -v, i);
  return r;
}

// ---- any model by automatic differentiation ----

template <class T>
inline Fabric<T> lift(const Fabric<Real>& f) {
  return {lift<T>(f.thickness), lift<T>(f.young), lift<T>(f.poisson), f.weave};
}
template <class T>
inline Invariants<T> lift(const Invariants<Real>& q) {
  Invariants<T> r;
  for (int i = 0; i < 3; ++i) r.l[i] = lift<T>(q.l[i]), r.s[i] = lift<T>(q.s[i]), r.c[i] = lift<T>(q.c[i]);
  return r;
}

// The energy; differences from the rest shape have the accurate values of `over`.
template <class Model, class T>
inline Energy<T> model_energy(const Invariants<T>& q, const Increase<Real>& over, const Rest& rest,
                              const Invariants<T>& q_rest, const Fabric<T>& fabric) {
  T dl[3];
  Real df[3];
  for (int i = 0; i < 3; ++i) {
    dl[i] = q.l[i] - q_rest.l[i];
    set_value(dl[i], over.l[i]);
    if constexpr (Model::bends) {
      Real s = value(q.s[i]), c = value(q.c[i]), f = Model::Fibre::f(s, c);
      df[i] = Model::Fibre::increase({s, c, f, rest.q.s[i], rest.q.c[i], over.s[i], over.c[i]});
    }
  }
  return Model::energy(q, dl, df, q_rest, fabric);
}

template <class Model, int order>
inline void evaluate_automatic(const Rest& r, const Invariants<Real>& at, const Increase<Real>& over,
                               Jet& jet) {
  constexpr int N = Model::bends ? 6 : 3;
  using T = std::conditional_t<order == 0, Real,
                               std::conditional_t<order == 1, Dual<Real, N>, Dual<Dual<Real, N>, N>>>;
  Invariants<T> q = lift<T>(at);
  for (int i = 0; i < 3 && order > 0; ++i) {
    if constexpr (order == 1) q.l[i] = variable<N>(at.l[i], i);
    if constexpr (order == 2) q.l[i] = variable2<N, N>(at.l[i], i);
    if constexpr (order == 1 && N == 6) {
      q.s[i] = wave<N>(at.s[i], at.c[i], 3 + i);
      q.c[i] = wave<N>(at.c[i], -at.s[i], 3 + i);
    }
    if constexpr (order == 2 && N == 6) {
      q.s[i] = wave2<N, N>(at.s[i], at.c[i], 3 + i);
      q.c[i] = wave2<N, N>(at.c[i], -at.s[i], 3 + i);
    }
  }
  auto e = model_energy<Model, T>(q, over, r, lift<T>(r.q), lift<T>(r.fabric));
  if constexpr (order == 0) {
    jet.energy = e;
  } else {
    T sum = e.stretching + e.bending;
    jet.energy = {value(e.stretching), value(e.bending)};
    for (int i = 0; i < 6; ++i) {
      jet.g[i] = i < N ? value(sum.d[i % N]) : Real(0.0);
      if constexpr (order == 2)
        for (int j = i; j < 6; ++j) jet.h[upper(i, j)] = j < N ? sum.d[i % N].d[j % N] : Real(0.0);
    }
  }
}

// ---- St. Venant-Kirchhoff by hand: quadratic in dl and II; far faster than the automatic derivatives ----

// Determinant of first_form(v) and of {v0 + v1, v0, v0 + v2}: second derivatives (equal, unequal indices).
constexpr double FIRST_DET[2] = {-0.5, 0.5}, SECOND_DET[2] = {0.0, 1.0};

// Second derivative i, j of major t^2 - minor d.
VOILE_INLINE Real stiffness(const QuadraticRest& r, const Real tau[3], const double det[2], int i, int j) {
  return Real(2.0) * r.major * tau[i] * tau[j] - Real(det[i != j]) * r.minor;
}

// Its gradient into s; returns its value.
VOILE_INLINE Real stress(const QuadraticRest& r, const Real tau[3], const double det[2], const Real v[3],
                         Real s[3]) {
  Real twice = Real(2.0) * r.major * (tau[0] * v[0] + tau[1] * v[1] + tau[2] * v[2]),
       sum = v[0] + v[1] + v[2];
  Real energy = 0.0;
  for (int i = 0; i < 3; ++i) {
    s[i] = twice * tau[i] - r.minor * (Real(det[0]) * v[i] + Real(det[1]) * (sum - v[i]));
    energy += Real(0.5) * s[i] * v[i];
  }
  return energy;
}

// The stretching (v = dl) or the bending energy (v = II - II_rest).
template <bool bends>
struct IsotropicForm {
  const QuadraticRest& r;
  Real tau[3];

  VOILE_INLINE explicit IsotropicForm(const QuadraticRest& r) : r(r) {
    const Real &a = r.inverse.a, &b = r.inverse.b, &c = r.inverse.c;
    if constexpr (bends)
      tau[0] = a + Real(2.0) * b + c, tau[1] = a, tau[2] = c;
    else
      tau[0] = -b, tau[1] = b + c, tau[2] = a + b;
  }
  VOILE_INLINE Real stiffness(int i, int j) const {
    Real k = voile::VOILE_ISA::stiffness(r, tau, bends ? SECOND_DET : FIRST_DET, i, j);
    return bends ? r.ratio * k : k;
  }
  VOILE_INLINE Real stress(const Real v[3], Real s[3]) const {
    if constexpr (!bends) return voile::VOILE_ISA::stress(r, tau, FIRST_DET, v, s);
    const Real scaled[3] = {r.ratio * v[0], r.ratio * v[1], r.ratio * v[2]};
    return voile::VOILE_ISA::stress(r, tau, SECOND_DET, scaled, s) / r.ratio;
  }
};

template <bool bends>
struct WovenForm {
  const Real* m;

  VOILE_INLINE explicit WovenForm(const WovenRest& r) : m(bends ? r.bend : r.stretch) {}
  VOILE_INLINE Real stiffness(int i, int j) const { return i > j ? stiffness(j, i) : m[i + j + (i > 0)]; }
  VOILE_INLINE Real stress(const Real v[3], Real s[3]) const {
    s[0] = m[0] * v[0] + m[1] * v[1] + m[2] * v[2];
    s[1] = m[1] * v[0] + m[3] * v[1] + m[4] * v[2];
    s[2] = m[2] * v[0] + m[4] * v[1] + m[5] * v[2];
    return Real(0.5) * (s[0] * v[0] + s[1] * v[1] + s[2] * v[2]);
  }
};
template <class Model, bool bends>
using FormOf = std::conditional_t<Model::woven, WovenForm<bends>, IsotropicForm<bends>>;

template <class Model>
inline WovenRest woven_rest(const Rest& rest) {
  using T = Dual<Dual<Real, 3>, 3>;
  WovenRest r;
  T v[3];
  for (int i = 0; i < 3; ++i) v[i] = variable2<3, 3>(Real(0.0), i);
  Sym2<Real> form = first_form(rest.q.l), i = form.inverse();
  Sym2<T> inverse{lift<T>(i.a), lift<T>(i.b), lift<T>(i.c)}, dl = first_form(v), ii = second_form(v);
  Fabric<T> fabric = lift<T>(rest.fabric);
  Real twice_area = sqrt(form.det()), area = Real(0.5) * twice_area;
  T stretching = Orthotropic::stretching(inverse, dl, inverse, fabric);
  T bending = Orthotropic::bending(inverse, dl, inverse, inverse, ii, fabric);
  for (int k = 0, n = 0; k < 3; ++k) {
    r.height[k] = Real(2.0) * twice_area / sqrt(rest.q.l[k]);
    for (int j = k; j < 3; ++j, ++n)
      r.stretch[n] = area * stretching.d[k].d[j], r.bend[n] = area * bending.d[k].d[j];
  }
  return r;
}

template <class Model>
inline RestOf<Model> quadratic_rest(const Rest& rest) {
  if constexpr (Model::woven) {
    return woven_rest<Model>(rest);
  } else {
    QuadraticRest r;
    const Fabric<Real>& f = rest.fabric;
    Sym2<Real> form = first_form(rest.q.l), i = form.inverse();
    Real twice_area = sqrt(form.det()), modulus = Real(0.125) * twice_area * f.thickness * f.young;
    r.major = Real(0.5) * modulus / (Real(1.0) - f.poisson * f.poisson);
    r.minor = modulus / ((Real(1.0) + f.poisson) * form.det());
    r.ratio = f.thickness * f.thickness * Real(1.0 / 3.0);
    r.inverse = i;
    for (int k = 0; k < 3; ++k) r.height[k] = Real(2.0) * twice_area / sqrt(rest.q.l[k]);
    return r;
  }
}

template <class Model, int order>
VOILE_INLINE void bend_quadratic(const RestOf<Model>& r, const Local& w, Jet& jet) {
  using F = Dual<Dual<Real, 1>, 1>;
  const Invariants<Real>& q = w.q;
  const Real *l = q.l, *dl = w.over.l;
  const FormOf<Model, true> form(r);
  Real ii[3], f1[3], f2[3], height[3], inverse_l[3], change[3], moment[3];
  const Real det_grown = det_increase(l, dl);
  for (int i = 0; i < 3; ++i) {
    F f = Model::Fibre::f(wave2<1, 1>(q.s[i], q.c[i], 0), wave2<1, 1>(q.c[i], -q.s[i], 0));
    f1[i] = f.d[0].v, f2[i] = f.d[0].d[0];
    height[i] = Real(2.0) * w.t.twice_area * w.t.unit[i];
    inverse_l[i] = w.t.unit[i] * w.t.unit[i];
    ii[i] = height[i] * f.v.v;
    Real turned =
        Model::Fibre::increase({q.s[i], q.c[i], f.v.v, w.s_rest[i], w.c_rest[i], w.over.s[i], w.over.c[i]});
    Real grown = height_increase(height[i], r.height[i], inverse_l[i], dl[i], det_grown);
    change[i] = height[i] * turned + grown * (f.v.v - turned);
  }
  jet.energy.bending = form.stress(change, moment);
  if constexpr (order == 0) return;
  Real inverse = w.t.inverse * w.t.inverse, half = Real(0.5) * (l[0] + l[1] + l[2]);
  Real slope_det[3], rate[3][3], first[3][6];  // d ln det/dl_i; d ln height_i/dl_j; dII_i/dq
  for (int i = 0; i < 3; ++i) slope_det[i] = (half - l[i]) * inverse;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      rate[i][j] = Real(0.5) * slope_det[j];
      if (i == j) rate[i][j] -= Real(0.5) * inverse_l[i];
      first[i][j] = ii[i] * rate[i][j];
      first[i][3 + j] = i == j ? height[i] * f1[i] : Real(0.0);
      jet.g[j] += moment[i] * first[i][j];
    }
    jet.g[3 + i] = moment[i] * first[i][3 + i];
  }
  if constexpr (order < 2) return;
  Real turned[3][6];  // stiffness times dII/dq
  for (int i = 0; i < 3; ++i)
    for (int p = 0; p < 6; ++p) {
      turned[i][p] = 0.0;
      for (int j = 0; j < 3; ++j)
        if (p < 3 || p - 3 == j) turned[i][p] += form.stiffness(i, j) * first[j][p];
    }
  for (int p = 0; p < 6; ++p)
    for (int k = p; k < 6; ++k)
      for (int i = 0; i < 3; ++i)
        if (p < 3 || p - 3 == i) jet.h[upper(p, k)] += first[i][p] * turned[i][k];
  Real lengths = moment[0] * ii[0] + moment[1] * ii[1] + moment[2] * ii[2];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = j; k < 3; ++k) jet.h[upper(j, k)] += moment[i] * ii[i] * rate[i][j] * rate[i][k];
      jet.h[upper(j, 3 + i)] += moment[i] * height[i] * f1[i] * rate[i][j];
    }
    jet.h[upper(i, i)] += moment[i] * ii[i] * Real(0.5) * inverse_l[i] * inverse_l[i];
    jet.h[upper(3 + i, 3 + i)] += moment[i] * height[i] * f2[i];
    for (int k = i; k < 3; ++k)
      jet.h[upper(i, k)] +=
          Real(0.5) * lengths * (Real(i == k ? -0.5 : 0.5) * inverse - slope_det[i] * slope_det[k]);
  }
}

template <class Model, int order>
VOILE_INLINE void evaluate_quadratic(const RestOf<Model>& r, const Local& w, Jet& jet) {
  const FormOf<Model, false> form(r);
  jet.energy = {form.stress(w.over.l, jet.g), 0.0};
  for (int i = 3; i < 6; ++i) jet.g[i] = 0.0;
  if constexpr (order == 2)
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) jet.h[upper(i, j)] = j < 3 ? form.stiffness(i, j) : Real(0.0);
  if constexpr (Model::bends) bend_quadratic<Model, order>(r, w, jet);
}

// ---- Projective Dynamics by hand: a function of two numbers in stretching, quadratic in sines in bending
// ----

template <int order>
VOILE_INLINE void stretch_biot(const QuadraticRest& r, const Real dl[3], Jet& jet) {
  using T = std::conditional_t<order == 0, Real,
                               std::conditional_t<order == 1, Dual<Real, 2>, Dual<Dual<Real, 2>, 2>>>;
  const Real tau[3] = {-r.inverse.b, r.inverse.b + r.inverse.c, r.inverse.a + r.inverse.b};
  const Real scale = r.inverse.det(), sum = dl[0] + dl[1] + dl[2];
  Real slope[3], d = 0.0, q = 0.0;  // of q = det(C - I)
  for (int i = 0; i < 3; ++i) {
    slope[i] = scale * (Real(FIRST_DET[0]) * dl[i] + Real(FIRST_DET[1]) * (sum - dl[i]));
    d += tau[i] * dl[i], q += Real(0.5) * slope[i] * dl[i];
  }
  T d_variable = lift<T>(d), q_variable = lift<T>(q);
  if constexpr (order == 1) d_variable = variable<2>(d, 0), q_variable = variable<2>(q, 1);
  if constexpr (order == 2) d_variable = variable2<2, 2>(d, 0), q_variable = variable2<2, 2>(q, 1);
  Projective::Strain<T> e(d_variable, q_variable);
  // Small strains are half of C - I: its square and determinant count four times.
  T w = lift<T>(Real(4.0) * r.major) * e.trace * e.trace - lift<T>(Real(4.0) * r.minor / scale) * e.det;
  jet.energy = {value(w), 0.0};
  if constexpr (order > 0)
    for (int i = 0; i < 3; ++i) jet.g[i] = value(w.d[0]) * tau[i] + value(w.d[1]) * slope[i];
  if constexpr (order == 2)
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j)
        jet.h[upper(i, j)] = w.d[0].d[0] * tau[i] * tau[j] +
                             w.d[0].d[1] * (tau[i] * slope[j] + tau[j] * slope[i]) +
                             w.d[1].d[1] * slope[i] * slope[j] + w.d[1].v * scale * Real(FIRST_DET[i != j]);
}

template <class Model, int order>
VOILE_INLINE void evaluate_biot(const QuadraticRest& r, const Local& w, Jet& jet) {
  stretch_biot<order>(r, w.over.l, jet);
  const Real &a = r.inverse.a, &b = r.inverse.b, &d = r.inverse.c;
  // Scalar products of the shape functions' gradients, which are -nu_i over the altitudes: diagonal; others.
  const Real tau[3] = {a + Real(2.0) * b + d, a, d}, across[3] = {b, -b - d, -a - b};
  Real normal[3], out[3], normal_slope[3],
      out_slope[3];  // increase of II_i along normal and nu_i; by alpha_i
  for (int i = 0; i < 3; ++i) {
    const Real &s = w.q.s[i], &c = w.q.c[i], &height = r.height[i], turned = height * w.over.s[i];
    normal[i] = turned * (c * w.c_rest[i] - s * w.s_rest[i]);
    out[i] = turned * (s * w.c_rest[i] + c * w.s_rest[i]);
    normal_slope[i] = height * (c * c - s * s), out_slope[i] = Real(2.0) * height * s * c;
  }
  Real stiff[3][3], stiff_out[3][3], force[3] = {0.0, 0.0, 0.0}, force_out[3] = {0.0, 0.0, 0.0};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      stiff[i][j] = r.ratio * stiffness(r, tau, SECOND_DET, i, j);
      const Real cosine = i == j ? Real(1.0) : Real(0.25) * r.height[i] * r.height[j] * across[3 - i - j];
      stiff_out[i][j] = stiff[i][j] * cosine;
      force[i] += stiff[i][j] * normal[j], force_out[i] += stiff_out[i][j] * out[j];
    }
  for (int i = 0; i < 3; ++i)
    jet.energy.bending += Real(0.5) * (force[i] * normal[i] + force_out[i] * out[i]);
  if constexpr (order == 0) return;
  for (int i = 0; i < 3; ++i) jet.g[3 + i] = force[i] * normal_slope[i] + force_out[i] * out_slope[i];
  if constexpr (order < 2) return;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      jet.h[upper(i, 3 + j)] = 0.0;
      if (j < i) continue;
      Real& h = jet.h[upper(3 + i, 3 + j)];
      h = stiff[i][j] * normal_slope[i] * normal_slope[j] + stiff_out[i][j] * out_slope[i] * out_slope[j];
      if (i == j) h += Real(2.0) * (force_out[i] * normal_slope[i] - force[i] * out_slope[i]);
    }
}

}  // namespace VOILE_ISA
}  // namespace voile
