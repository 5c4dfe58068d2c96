// Derivatives of a triangle's energy that no equilibrium needs: to the rest shape and the fabric, and the
// parts of the stresses, for any model by automatic differentiation.
#pragma once

#include "density.hpp"

namespace voile {
inline namespace VOILE_ISA {

// Invariants at rest as variables of T's inner type D, the first six of its N; on: share of the rest shape's
// turn about each edge that acts on q (sines s, cosines c, to be derived), not on q_rest.
template <class T, int N>
struct Varied {
  using D = Dual<Real, N>;
  Invariants<T> rest;
  D s[3], c[3];

  Varied(const Local& w, const Rest& r, const Real on[3]) {
    for (int i = 0; i < 3; ++i) {
      const Real off = Real(1.0) - on[i];
      s[i] = wave<N>(w.q.s[i], -on[i] * w.q.c[i], 3 + i), c[i] = wave<N>(w.q.c[i], on[i] * w.q.s[i], 3 + i);
      rest.l[i] = T(variable<N>(r.q.l[i], i));
      rest.s[i] = T(wave<N>(r.q.s[i], off * r.q.c[i], 3 + i));
      rest.c[i] = T(wave<N>(r.q.c[i], -off * r.q.s[i], 3 + i));
    }
  }
};

// See Elastic::mixed.
template <class Model>
void store_mixed(const Block& block, const Local& w, const Rest& r, const Real on[3], double* q_rest,
                 double* q_fabric, double* fabric) {
  using D = Dual<Real, 9>;
  using T = Dual<D, 6>;
  Varied<T, 9> varied(w, r, on);
  Invariants<T> q = lift<T>(w.q);
  for (int i = 0; i < 3; ++i) {
    const D &s = varied.s[i], &c = varied.c[i];
    q.l[i].d[i] = D(1.0);
    q.s[i] = T(s), q.s[i].d[3 + i] = c, q.c[i] = T(c), q.c[i].d[3 + i] = D(-1.0) * s;
  }
  Fabric<T> f{T(variable<9>(r.fabric.thickness, 6)), T(variable<9>(r.fabric.young, 7)),
              T(variable<9>(r.fabric.poisson, 8)), r.fabric.weave};
  auto e = model_energy<Model, T>(q, w.over, r, varied.rest, f);
  T sum = e.stretching + e.bending;
  for (int lane = 0; lane < block.count; ++lane) {
    size_t t = (size_t)block.first + lane;
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) q_rest[36 * t + 6 * i + j] = sum.d[i].d[j][lane];
      for (int j = 0; j < 3; ++j) q_fabric[18 * t + 3 * i + j] = sum.d[i].d[6 + j][lane];
    }
    for (int j = 0; j < 3; ++j) fabric[3 * t + j] = sum.v.d[6 + j][lane];
  }
}

// See Elastic::mixed_along. Inner derivatives: by q_rest; outer: along the rate of q.
template <class Model>
void store_mixed_along(const Block& block, const Local& w, const Rest& r, const Real on[3],
                       const double* rate, double* slope) {
  using D = Dual<Real, 6>;
  using T = Dual<D, 1>;
  auto rate_of = [&](int k) {
    return gather([&](int lane) { return rate[6 * (block.first + std::min(lane, block.count - 1)) + k]; });
  };
  Varied<T, 6> varied(w, r, on);
  Invariants<T> q = lift<T>(w.q);
  for (int i = 0; i < 3; ++i) {
    const D &s = varied.s[i], &c = varied.c[i], turn = D(rate_of(3 + i));
    q.l[i].d[0] = D(rate_of(i));
    q.s[i] = T(s), q.s[i].d[0] = turn * c, q.c[i] = T(c), q.c[i].d[0] = D(-1.0) * turn * s;
  }
  auto e = model_energy<Model, T>(q, w.over, r, varied.rest, lift<T>(r.fabric));
  T sum = e.stretching + e.bending;
  for (int lane = 0; lane < block.count; ++lane)
    for (int k = 0; k < 6; ++k) slope[6 * ((size_t)block.first + lane) + k] = sum.d[0].d[k][lane];
}

// See Elastic::stresses.
template <class Model>
void store_stresses(const Block& block, const Local& w, const Rest& r, double* out) {
  using T = Dual<Real, 6>;
  Invariants<T> q = lift<T>(w.q);
  for (int i = 0; i < 3; ++i) {
    q.l[i] = variable<6>(w.q.l[i], i);
    q.s[i] = wave<6>(w.q.s[i], w.q.c[i], 3 + i), q.c[i] = wave<6>(w.q.c[i], -w.q.s[i], 3 + i);
  }
  auto e = model_energy<Model, T>(q, w.over, r, lift<T>(r.q), lift<T>(r.fabric));
  for (int lane = 0; lane < block.count; ++lane) {
    double* row = out + 8 * ((size_t)block.first + lane);
    row[0] = e.stretching.v[lane], row[1] = e.bending.v[lane];
    for (int i = 0; i < 3; ++i) row[2 + i] = e.stretching.d[i][lane], row[5 + i] = e.bending.d[3 + i][lane];
  }
}

}  // namespace VOILE_ISA
}  // namespace voile
