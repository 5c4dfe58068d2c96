// The elastic energy, gradient and Hessian of a mesh for every model of models.hpp; the only assembly loops.
// Compiled once per instruction set with its own VOILE_LANES and VOILE_ISA.
#include <algorithm>
#include <map>
#include <stdexcept>
#include <string>

#include "elastic.hpp"
#include "geometry.hpp"
#include "models.hpp"
#include "scatter.hpp"

namespace voile {
inline namespace VOILE_ISA {

constexpr int upper(int i, int j) { return i <= j ? i * 6 - i * (i - 1) / 2 + j - i : upper(j, i); }

// Value and derivatives of W with respect to l (0..2) and alpha (3..5).
struct Jet {
  Energy<Real> energy;
  Real g[6];
  Real h[21];
};

// How alpha of a half edge depends on its own triangle (factor of c_ij n) and on the neighbour.
struct Hinge {
  Real factor;
  Vec3 n;                      // the neighbour's normal
  Real at_opposite, at_a, at_b;  // half the neighbour's coefficients: vertex across, corners i+1, i+2
};

struct Local {
  Triangle t;
  Invariants<Real> q;
  Real dl[3];
  Hinge hinge[3];
};

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

// Projects symmetric 6x6 matrices (upper triangles) on the positive semidefinite cone: cyclic Jacobi rotations in a
// basis scaled by the diagonal, negative eigenvalues set to zero.
void project_positive(Real h[21]) {
  Real a[6][6], v[6][6], scale[6];
  for (int i = 0; i < 6; ++i) {
    Real d = h[upper(i, i)];
    scale[i] = sqrt(max(max(d, -d), Real(1e-300)));
  }
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) {
      a[i][j] = h[upper(i, j)] / (scale[i] * scale[j]);
      v[i][j] = i == j ? 1.0 : 0.0;
    }
  for (int sweep = 0; sweep < 7; ++sweep)
    for (int p = 0; p < 5; ++p)
      for (int q = p + 1; q < 6; ++q) {
        Real off = a[p][q];
        Mask small = (off.p < 1e-30) & (off.p > -1e-30);
        Real ratio = (a[q][q] - a[p][p]) / (Real(2.0) * select(small, Real(1.0), off));
        Real size = max(ratio, -ratio);
        Real tangent = Real(1.0) / (size + sqrt(ratio * ratio + Real(1.0)));
        tangent = select(ratio.p < 0.0, -tangent, tangent);
        tangent = select(small, Real(0.0), tangent);
        Real c = Real(1.0) / sqrt(tangent * tangent + Real(1.0)), s = tangent * c;
        for (int k = 0; k < 6; ++k) {
          Real x = a[k][p], y = a[k][q];
          a[k][p] = c * x - s * y;
          a[k][q] = s * x + c * y;
        }
        for (int k = 0; k < 6; ++k) {
          Real x = a[p][k], y = a[q][k];
          a[p][k] = c * x - s * y;
          a[q][k] = s * x + c * y;
          x = v[k][p], y = v[k][q];
          v[k][p] = c * x - s * y;
          v[k][q] = s * x + c * y;
        }
      }
  for (int i = 0; i < 6; ++i)
    for (int j = i; j < 6; ++j) {
      Real sum = 0.0;
      for (int k = 0; k < 6; ++k) sum += max(a[k][k], Real(0.0)) * v[i][k] * v[j][k];
      h[upper(i, j)] = sum * scale[i] * scale[j];
    }
}

template <class Model>
class ElasticModel final : public Elastic {
  static constexpr int N = Model::bends ? 6 : 3;

  Mesh mesh;
  int blocks;
  std::vector<int> clamp_of;  // (3m) index into clamps, -1; empty without clamps
  std::vector<Clamp> clamps;
  std::vector<double> weight, turn_weight;
  // Per block: rest invariants, l(start) - l(rest), fabric; for quadratic models their two constant 3x3 matrices.
  struct Rest {
    Invariants<Real> q;
    Real dl[3], ii[3], stretch[6], bend[6];
    Fabric<Real> fabric;
  };
  std::vector<Rest> rest;
  std::vector<double> rest_points;
  std::vector<int> rest_corner;
  bool rest_flat = false;
  std::vector<Facet> facets;
  std::vector<double> slope;  // (3m) factor * dW/dalpha
  std::vector<double> predicted_slope, predicted_tension;  // (3m) the same and dW/dl, extrapolated by predict()

  int triangle_at(int block, int lane) const { return std::min(block * LANES + lane, mesh.triangles - 1); }
  int lanes_in(int block) const { return std::min(LANES, mesh.triangles - block * LANES); }

  Corners load(int block, const int* corner, const double* base, const double* displacement) const {
    Corners p;
    for (int j = 0; j < 3; ++j)
      for (int lane = 0; lane < LANES; ++lane) {
        const size_t at = 3 * (size_t)corner[3 * (size_t)triangle_at(block, lane) + j];
        const double* x = base + at;
        double u[3] = {0, 0, 0};
        if (displacement)
          for (int k = 0; k < 3; ++k) u[k] = displacement[at + k];
        p.u[j].x.p[lane] = u[0], p.u[j].y.p[lane] = u[1], p.u[j].z.p[lane] = u[2];
        p.x[j].x.p[lane] = x[0] + u[0], p.x[j].y.p[lane] = x[1] + u[1], p.x[j].z.p[lane] = x[2] + u[2];
      }
    return p;
  }

  void compute_facets(const int* corner, const double* base, const double* displacement) {
    facets.resize(mesh.triangles);
    for (int b = 0; b < blocks; ++b) {
      Triangle t = triangle_geometry(load(b, corner, base, displacement));
      for (int lane = 0; lane < lanes_in(b); ++lane) {
        Facet& f = facets[b * LANES + lane];
        f.n[0] = t.n.x[lane], f.n[1] = t.n.y[lane], f.n[2] = t.n.z[lane];
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) f.c[3 * i + j] = t.c[i][j][lane];
      }
    }
  }

  // Half angles and hinge coefficients of the block's edges; directors and clamps only for the deformed shape.
  void compute_hinges(int block, Local& w, const double* director, bool deformed) const {
    for (int i = 0; i < 3; ++i) {
      Hinge& g = w.hinge[i];
      g.n = w.t.n;
      g.factor = g.at_opposite = g.at_a = g.at_b = 0.0;
      for (int lane = 0; lane < LANES; ++lane) {
        int half = 3 * triangle_at(block, lane) + i, other = mesh.across[half];
        if (other < 0 || (deformed && !clamp_of.empty() && clamp_of[half] >= 0)) continue;
        const Facet& f = facets[other / 3];
        const double* c = f.c + 3 * (other % 3);
        g.n.x.p[lane] = f.n[0], g.n.y.p[lane] = f.n[1], g.n.z.p[lane] = f.n[2];
        g.factor.p[lane] = 0.5;
        g.at_opposite.p[lane] = 0.5 * c[other % 3];
        g.at_a.p[lane] = 0.5 * c[(other % 3 + 2) % 3];
        g.at_b.p[lane] = 0.5 * c[(other % 3 + 1) % 3];
      }
      Vec3 unit = (Real(1.0) / w.t.root[i]) * w.t.e[i];
      half_fold(w.t.n, g.n, unit, w.q.s[i], w.q.c[i]);
      if (!deformed) continue;
      if (!clamp_of.empty()) hold_director(block, i, w, unit);
      if constexpr (Model::directors) turn_director(block, i, w, director);
    }
  }

  void turn_director(int block, int i, Local& w, const double* director) const {
    Real sine = 0.0, cosine = 1.0;
    bool any = false;
    for (int lane = 0; lane < LANES; ++lane) {
      int half = 3 * triangle_at(block, lane) + i;
      double phi = director[mesh.edge[half]];
      if (phi == 0.0) continue;
      any = true;
      sine.p[lane] = mesh.sign[half] * std::sin(phi), cosine.p[lane] = std::cos(phi);
    }
    if (!any) return;
    Real s = w.q.s[i], c = w.q.c[i];
    w.q.s[i] = s * cosine + c * sine;
    w.q.c[i] = c * cosine - s * sine;
  }

  // A clamped half edge: alpha is the whole angle from the normal to the held director, and only its own triangle
  // can turn.
  void hold_director(int block, int i, Local& w, const Vec3& unit) const {
    Vec3 conormal = cross(unit, w.t.n);
    for (int lane = 0; lane < LANES; ++lane) {
      int held = clamp_of[3 * triangle_at(block, lane) + i];
      if (held < 0) continue;
      const Clamp& k = clamps[held];
      double along_n = w.t.n.x[lane] * k.vector[0] + w.t.n.y[lane] * k.vector[1] + w.t.n.z[lane] * k.vector[2];
      double along_m = conormal.x[lane] * k.vector[0] + conormal.y[lane] * k.vector[1] + conormal.z[lane] * k.vector[2];
      double s = k.conormal ? -along_n : along_m, c = k.conormal ? along_m : along_n;
      double size = std::hypot(s, c);
      w.q.s[i].p[lane] = s / size, w.q.c[i].p[lane] = c / size;
      w.hinge[i].factor.p[lane] = 1.0;
    }
  }

  Local local(int block, State state) const {
    Local w;
    w.t = triangle_geometry(load(block, mesh.corner.data(), mesh.start.data(), state.displacement));
    for (int i = 0; i < 3; ++i) {
      w.q.l[i] = w.t.l[i];
      w.dl[i] = w.t.dl[i] + rest[block].dl[i];
    }
    if constexpr (Model::bends)
      compute_hinges(block, w, state.director, true);
    else
      for (int i = 0; i < 3; ++i) w.q.s[i] = 0.0, w.q.c[i] = 1.0;
    return w;
  }

  // ---- W and its derivatives ----

  template <class T>
  static Fabric<T> constant(const Fabric<Real>& f) {
    return {T(f.thickness), T(f.young), T(f.poisson)};
  }
  template <class T>
  static Invariants<T> constant(const Invariants<Real>& q) {
    Invariants<T> r;
    for (int i = 0; i < 3; ++i) r.l[i] = T(q.l[i]), r.s[i] = T(q.s[i]), r.c[i] = T(q.c[i]);
    return r;
  }

  template <class T>
  static Energy<T> model_energy(const Invariants<T>& q, const Real dl_value[3], const Invariants<T>& r,
                                const Fabric<T>& f) {
    T dl[3];
    for (int i = 0; i < 3; ++i) {
      dl[i] = q.l[i] - r.l[i];
      set_value(dl[i], dl_value[i]);
    }
    return Model::energy(q, dl, r, f);
  }

  template <int order>
  void evaluate(int block, const Local& w, Jet& jet) const {
    if constexpr (Model::quadratic)
      evaluate_quadratic<order>(rest[block], w, jet);
    else
      evaluate_automatic<order>(rest[block], w, jet);
  }

  template <int order>
  void evaluate_automatic(const Rest& r, const Local& w, Jet& jet) const {
    if constexpr (order == 0) {
      jet.energy = Model::energy(w.q, w.dl, r.q, r.fabric);
    } else if constexpr (order == 1) {
      using T = Dual<Real, N>;
      Invariants<T> q = constant<T>(w.q);
      for (int i = 0; i < 3; ++i) {
        q.l[i] = variable<N>(w.q.l[i], i);
        if constexpr (N == 6) {
          q.s[i] = wave<N>(w.q.s[i], w.q.c[i], 3 + i);
          q.c[i] = wave<N>(w.q.c[i], -w.q.s[i], 3 + i);
        }
      }
      auto e = model_energy<T>(q, w.dl, constant<T>(r.q), constant<T>(r.fabric));
      jet.energy = {e.stretching.v, e.bending.v};
      for (int i = 0; i < 6; ++i) jet.g[i] = i < N ? e.stretching.d[i % N] + e.bending.d[i % N] : Real(0.0);
    } else {
      using T = Dual<Dual<Real, N>, N>;
      Invariants<T> q = constant2<T>(w.q);
      for (int i = 0; i < 3; ++i) {
        q.l[i] = variable2<N, N>(w.q.l[i], i);
        if constexpr (N == 6) {
          q.s[i] = wave2<N, N>(w.q.s[i], w.q.c[i], 3 + i);
          q.c[i] = wave2<N, N>(w.q.c[i], -w.q.s[i], 3 + i);
        }
      }
      auto e = model_energy<T>(q, w.dl, constant2<T>(r.q), constant2<T>(r.fabric));
      jet.energy = {e.stretching.v.v, e.bending.v.v};
      for (int i = 0; i < 6; ++i) {
        jet.g[i] = i < N ? e.stretching.v.d[i % N] + e.bending.v.d[i % N] : Real(0.0);
        for (int j = i; j < 6; ++j)
          jet.h[upper(i, j)] = j < N ? e.stretching.d[i % N].d[j % N] + e.bending.d[i % N].d[j % N] : Real(0.0);
      }
    }
  }
  template <class T>
  static Invariants<T> constant2(const Invariants<Real>& q) {
    using D = decltype(T::v);
    Invariants<T> r;
    for (int i = 0; i < 3; ++i) r.l[i] = T(D(q.l[i])), r.s[i] = T(D(q.s[i])), r.c[i] = T(D(q.c[i]));
    return r;
  }
  template <class T>
  static Fabric<T> constant2(const Fabric<Real>& f) {
    using D = decltype(T::v);
    return {T(D(f.thickness)), T(D(f.young)), T(D(f.poisson))};
  }

  static constexpr int packed3(int i, int j) { return i <= j ? i * 3 - i * (i - 1) / 2 + j - i : packed3(j, i); }

  // St. Venant-Kirchhoff by hand: W = dl.S.dl/2 + dII.K.dII/2 with constant S and K; measured 20 times faster than
  // the automatic derivatives (scripts/bench-kernels).
  template <int order>
  void evaluate_quadratic(const Rest& r, const Local& w, Jet& jet) const {
    Real stress[3];
    jet.energy = {0.0, 0.0};
    for (int i = 0; i < 3; ++i) {
      stress[i] = 0.0;
      for (int j = 0; j < 3; ++j) stress[i] += r.stretch[packed3(i, j)] * w.dl[j];
      jet.energy.stretching += Real(0.5) * stress[i] * w.dl[i];
      jet.g[i] = stress[i];
      jet.g[3 + i] = 0.0;
    }
    if constexpr (order == 2)
      for (int i = 0; i < 6; ++i)
        for (int j = i; j < 6; ++j) jet.h[upper(i, j)] = j < 3 ? r.stretch[packed3(i, j)] : Real(0.0);
    if constexpr (Model::bends) bend_quadratic<order>(r, w, jet);
  }

  template <int order>
  static void bend_quadratic(const Rest& r, const Local& w, Jet& jet) {
    using F = Dual<Dual<Real, 1>, 1>;
    const Real* l = w.q.l;
    Real det = w.t.twice_area * w.t.twice_area, inverse = Real(1.0) / det;
    Real total = Real(0.5) * (l[0] + l[1] + l[2]), slope_det[3], ii[3], f[3], f1[3], f2[3], height[3];
    for (int i = 0; i < 3; ++i) {
      F v = Model::Fibre::f(wave2<1, 1>(w.q.s[i], w.q.c[i], 0), wave2<1, 1>(w.q.c[i], -w.q.s[i], 0));
      f[i] = v.v.v, f1[i] = v.d[0].v, f2[i] = v.d[0].d[0];
      height[i] = Real(2.0) * w.t.twice_area / w.t.root[i];
      ii[i] = height[i] * f[i];
      slope_det[i] = (total - l[i]) * inverse;  // d ln det / dl_i
    }
    Real moment[3];
    for (int i = 0; i < 3; ++i) {
      moment[i] = 0.0;
      for (int j = 0; j < 3; ++j) moment[i] += r.bend[packed3(i, j)] * (ii[j] - r.ii[j]);
      jet.energy.bending += Real(0.5) * moment[i] * (ii[i] - r.ii[i]);
    }
    if constexpr (order == 0) return;
    Real rate[3][3], first[3][6];  // d ln altitude_i / dl_j; dII_i/dq
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        rate[i][j] = Real(0.5) * slope_det[j];
        if (i == j) rate[i][j] -= Real(0.5) / l[i];
        first[i][j] = ii[i] * rate[i][j];
        first[i][3 + j] = i == j ? height[i] * f1[i] : Real(0.0);
        jet.g[j] += moment[i] * first[i][j];
      }
      jet.g[3 + i] += moment[i] * first[i][3 + i];
    }
    if constexpr (order < 2) return;
    Real turned[3][6];  // K dII/dq
    for (int i = 0; i < 3; ++i)
      for (int p = 0; p < 6; ++p) {
        turned[i][p] = 0.0;
        for (int j = 0; j < 3; ++j)
          if (p < 3 || p - 3 == j) turned[i][p] += r.bend[packed3(i, j)] * first[j][p];
      }
    for (int p = 0; p < 6; ++p)
      for (int q = p; q < 6; ++q)
        for (int i = 0; i < 3; ++i)
          if (p < 3 || p - 3 == i) jet.h[upper(p, q)] += first[i][p] * turned[i][q];
    Real lengths = 0.0;
    for (int i = 0; i < 3; ++i) lengths += moment[i] * ii[i];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        for (int k = j; k < 3; ++k) jet.h[upper(j, k)] += moment[i] * ii[i] * rate[i][j] * rate[i][k];
        jet.h[upper(j, 3 + i)] += moment[i] * height[i] * f1[i] * rate[i][j];
      }
      jet.h[upper(i, i)] += moment[i] * ii[i] * Real(0.5) / (l[i] * l[i]);
      jet.h[upper(3 + i, 3 + i)] += moment[i] * height[i] * f2[i];
      for (int k = i; k < 3; ++k)
        jet.h[upper(i, k)] += Real(0.5) * lengths * (Real(i == k ? -0.5 : 0.5) * inverse - slope_det[i] * slope_det[k]);
    }
  }

  // ---- rest state ----

  // Constant second derivatives of the quadratic energy, read off the model itself by differentiation.
  void prepare_quadratic(Rest& r) const {
    using T = Dual<Dual<Real, 3>, 3>;
    Sym2<T> rest_form = first_form(constant2<T>(r.q).l), inverse = rest_form.inverse();
    T area = 0.5 * sqrt(rest_form.det());
    Fabric<T> fabric = constant2<T>(r.fabric);
    T v[3];
    for (int i = 0; i < 3; ++i) v[i] = variable2<3, 3>(Real(0.0), i);
    T stretching = area * StVK::stretching(rest_form, first_form(v), inverse, fabric);
    Sym2<T> b{v[0] + v[1], v[0], v[0] + v[2]};
    T bending = area * StVK::bending(rest_form, b, inverse, Sym2<T>{0.0, 0.0, 0.0}, fabric);
    Real twice_area = sqrt(first_form(r.q.l).det());
    for (int i = 0; i < 3; ++i) {
      for (int j = i; j < 3; ++j) {
        r.stretch[packed3(i, j)] = stretching.d[i].d[j];
        r.bend[packed3(i, j)] = bending.d[i].d[j];
      }
      r.ii[i] = Real(2.0) * twice_area / sqrt(r.q.l[i]) * Model::Fibre::f(r.q.s[i], r.q.c[i]);
    }
  }

  void prepare() {
    if constexpr (Model::quadratic)
      for (auto& r : rest) prepare_quadratic(r);
  }

  // ---- assembly ----

  // Own part of dalpha_i/dx_j and the vertex across.
  static void alpha_gradient(const Local& w, Vec3 own[3][3], Vec3 across[3]) {
    for (int i = 0; i < 3; ++i) {
      const Hinge& g = w.hinge[i];
      for (int j = 0; j < 3; ++j) {
        own[i][j] = (g.factor * w.t.c[i][j]) * w.t.n;
        if (j == (i + 1) % 3) own[i][j] = own[i][j] + g.at_a * g.n;
        if (j == (i + 2) % 3) own[i][j] = own[i][j] + g.at_b * g.n;
      }
      across[i] = g.at_opposite * g.n;
    }
  }

  static void add_lane(double* target, int vertex, const Vec3& v, int lane) {
    target[3 * (size_t)vertex] += v.x[lane];
    target[3 * (size_t)vertex + 1] += v.y[lane];
    target[3 * (size_t)vertex + 2] += v.z[lane];
  }

  void scatter_gradient(int block, const Local& w, const Jet& jet, double* gradient, double* edge_gradient) const {
    Vec3 force[3], own[3][3], across[3];
    if constexpr (Model::bends) alpha_gradient(w, own, across);
    for (int j = 0; j < 3; ++j) {
      force[j] = {0.0, 0.0, 0.0};
      for (int i = 0; i < 3; ++i) {
        if (i != j) force[j] = force[j] + (Real(2.0 * eps(i, j)) * jet.g[i]) * w.t.e[i];
        if constexpr (Model::bends) force[j] = force[j] + jet.g[3 + i] * own[i][j];
      }
    }
    for (int lane = 0; lane < lanes_in(block); ++lane) {
      int t = block * LANES + lane;
      for (int i = 0; i < 3; ++i) {
        add_lane(gradient, mesh.corner[3 * t + i], force[i], lane);
        if constexpr (Model::bends) {
          int other = mesh.across[3 * t + i];
          if (other >= 0) add_lane(gradient, mesh.corner[other], jet.g[3 + i] * across[i], lane);
          if constexpr (Model::directors)
            edge_gradient[mesh.edge[3 * t + i]] += mesh.sign[3 * t + i] * jet.g[3 + i][lane];
        }
      }
    }
  }

  void sum_energy(int block, const Jet& jet, double* split) const {
    for (int lane = 0; lane < lanes_in(block); ++lane) {
      double w = weight[block * LANES + lane];
      if (w == 0.0) continue;
      split[0] += w * jet.energy.stretching[lane];
      split[1] += w * jet.energy.bending[lane];
    }
  }

  // Total weight of the fold's Hessian on this triangle's side of edge i.
  Real fold_weight(int block, int i) const {
    Real r;
    for (int lane = 0; lane < LANES; ++lane) {
      int half = 3 * triangle_at(block, lane) + i, other = mesh.across[half];
      bool held = !clamp_of.empty() && clamp_of[half] >= 0;
      r.p[lane] = slope[half] + (other >= 0 && !held ? slope[other] : 0.0);
      if (!turn_weight.empty()) r.p[lane] += turn_weight[half];
    }
    return r;
  }

  // stress: dW/dl of the geometric part.
  void fill_blocks(int block, const Local& w, const Jet& jet, const Real stress[3], bool safe, Real* out) const {
    constexpr int M = Model::bends ? 6 : 3;
    Vec3 own[3][3], across[3], mj[6][3];
    if constexpr (Model::bends) alpha_gradient(w, own, across);
    for (int p = 0; p < M; ++p)
      for (int j = 0; j < 3; ++j) {
        mj[p][j] = {0.0, 0.0, 0.0};
        for (int i = 0; i < 3; ++i) {
          if (i != j) mj[p][j] = mj[p][j] + (Real(2.0 * eps(i, j)) * jet.h[upper(p, i)]) * w.t.e[i];
          if constexpr (Model::bends) mj[p][j] = mj[p][j] + jet.h[upper(p, 3 + i)] * own[i][j];
        }
      }
    Vec3 fold[3][3];
    const bool folds = Model::bends && !safe;
    if (folds) {
      Real total[3] = {fold_weight(block, 0), fold_weight(block, 1), fold_weight(block, 2)};
      fold_hessian(w.t, total, fold);
    }
    auto put = [out](int a, int b, const Vec3& row, const Vec3& column) {
      Real* o = out + BLOCKS.start[a][b];
      o[0] += row.x * column.x, o[1] += row.x * column.y, o[2] += row.x * column.z;
      o[3] += row.y * column.x, o[4] += row.y * column.y, o[5] += row.y * column.z;
      o[6] += row.z * column.x, o[7] += row.z * column.y, o[8] += row.z * column.z;
    };
    for (int k = 0; k < BLOCKS_LENGTH; ++k) out[k] = 0.0;
    for (int j = 0; j < 3; ++j)
      for (int k = j; k < 3; ++k) {
        for (int i = 0; i < 3; ++i) {
          if (i != j) put(j, k, Real(2.0 * eps(i, j)) * w.t.e[i], mj[i][k]);
          if constexpr (Model::bends) put(j, k, own[i][j], mj[3 + i][k]);
        }
        if (folds) {
          put(j, k, Real(0.5) * w.t.n, fold[j][k]);
          put(j, k, fold[k][j], Real(0.5) * w.t.n);
        }
        Real tension = 0.0;
        for (int i = 0; i < 3; ++i)
          if (eps(i, j) * eps(i, k) != 0.0)
            tension += Real(2.0 * eps(i, j) * eps(i, k)) * (safe ? max(stress[i], Real(0.0)) : stress[i]);
        Real* o = out + BLOCKS.start[j][k];
        o[0] += tension, o[4] += tension, o[8] += tension;
      }
    if constexpr (Model::bends) fill_across(w, block, jet, own, across, mj, put, out);
  }

  template <class Put>
  void fill_across(const Local& w, int block, const Jet& jet, const Vec3 own[3][3], const Vec3 across[3],
                   const Vec3 mj[6][3], Put put, Real* out) const {
    (void)own;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) put(k, 3 + i, mj[3 + i][k], across[i]);
      for (int k = i; k < 3; ++k) put(3 + i, 3 + k, jet.h[upper(3 + i, 3 + k)] * across[i], across[k]);
    }
    if constexpr (Model::directors) {
      Real sign[3];
      for (int i = 0; i < 3; ++i)
        for (int lane = 0; lane < LANES; ++lane) sign[i].p[lane] = mesh.sign[3 * triangle_at(block, lane) + i];
      auto column = [out](int a, int b, const Vec3& v) {
        Real* o = out + BLOCKS.start[a][b];
        o[0] = v.x, o[1] = v.y, o[2] = v.z;
      };
      for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) {
          column(k, 6 + i, sign[i] * mj[3 + i][k]);
          column(3 + k, 6 + i, (sign[i] * jet.h[upper(3 + i, 3 + k)]) * across[k]);
          if (k >= i) out[BLOCKS.start[6 + i][6 + k]] = sign[i] * sign[k] * jet.h[upper(3 + i, 3 + k)];
        }
    }
    (void)w;
  }

  void store_jacobian(int block, const Local& w, bool deformed, double* jacobian) const {
    Vec3 own[3][3], across[3];
    if constexpr (Model::bends) alpha_gradient(w, own, across);
    for (int lane = 0; lane < lanes_in(block); ++lane) {
      int t = block * LANES + lane;
      double* out = jacobian + (size_t)126 * t;
      std::fill(out, out + 126, 0.0);
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          double* row = out + 21 * i + 3 * j;
          row[0] = 2.0 * eps(i, j) * w.t.e[i].x[lane];
          row[1] = 2.0 * eps(i, j) * w.t.e[i].y[lane];
          row[2] = 2.0 * eps(i, j) * w.t.e[i].z[lane];
          if (!Model::bends || (!deformed && rest_flat)) continue;
          row += 21 * 3;
          row[0] = own[i][j].x[lane], row[1] = own[i][j].y[lane], row[2] = own[i][j].z[lane];
          if (j > 0) continue;
          row = out + 21 * (3 + i);
          row[9 + 3 * i] = across[i].x[lane], row[10 + 3 * i] = across[i].y[lane], row[11 + 3 * i] = across[i].z[lane];
          if (Model::directors && deformed) row[18 + i] = mesh.sign[3 * t + i];
        }
    }
  }

 public:
  explicit ElasticModel(Mesh m) : mesh(std::move(m)), blocks((mesh.triangles + LANES - 1) / LANES) {
    weight.assign(mesh.triangles, 1.0);
    rest.resize(blocks);
    slope.assign(3 * (size_t)mesh.triangles, 0.0);
  }

  bool bends() const override { return Model::bends; }
  bool directors() const override { return Model::directors; }

  void set_clamps(const std::vector<Clamp>& list) override {
    clamps = list;
    clamp_of.assign(list.empty() ? 0 : 3 * (size_t)mesh.triangles, -1);
    for (size_t k = 0; k < clamps.size(); ++k) clamp_of[clamps[k].half_edge] = (int)k;
  }

  void set_rest(const double* points, const int* corners, bool flat) override {
    rest_corner.assign(corners, corners + 3 * (size_t)mesh.triangles);
    int count = rest_corner.empty() ? 0 : 1 + *std::max_element(rest_corner.begin(), rest_corner.end());
    rest_points.assign(points, points + 3 * (size_t)count);
    rest_flat = flat;
    compute_facets(rest_corner.data(), rest_points.data(), nullptr);
    for (int b = 0; b < blocks; ++b) {
      Rest& r = rest[b];
      Local w;
      w.t = triangle_geometry(load(b, rest_corner.data(), rest_points.data(), nullptr));
      compute_hinges(b, w, nullptr, false);
      Triangle start = triangle_geometry(load(b, mesh.corner.data(), mesh.start.data(), nullptr));
      for (int i = 0; i < 3; ++i) {
        r.q.l[i] = w.t.l[i];
        r.q.s[i] = flat ? Real(0.0) : w.q.s[i];
        r.q.c[i] = flat ? Real(1.0) : w.q.c[i];
        r.dl[i] = start.l[i] - w.t.l[i];
      }
    }
  }

  void set_fabric(const double* thickness, const double* young, const double* poisson) override {
    for (int b = 0; b < blocks; ++b)
      for (int lane = 0; lane < LANES; ++lane) {
        int t = triangle_at(b, lane);
        rest[b].fabric.thickness.p[lane] = thickness[t];
        rest[b].fabric.young.p[lane] = young[t];
        rest[b].fabric.poisson.p[lane] = poisson[t];
      }
    prepare();
  }

  void set_weights(const double* w) override { weight.assign(w, w + mesh.triangles); }
  void set_turn_weights(const double* w) override { turn_weight.assign(w, w + 3 * (size_t)mesh.triangles); }

  void energy(State state, double* split) override {
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    split[0] = split[1] = 0.0;
    Jet jet;
    for (int b = 0; b < blocks; ++b) {
      evaluate<0>(b, local(b, state), jet);
      sum_energy(b, jet, split);
    }
  }

  void gradient(State state, double* split, double* gradient, double* edge_gradient) override {
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    split[0] = split[1] = 0.0;
    Jet jet;
    for (int b = 0; b < blocks; ++b) {
      Local w = local(b, state);
      evaluate<1>(b, w, jet);
      sum_energy(b, jet, split);
      scatter_gradient(b, w, jet, gradient, edge_gradient);
    }
  }

  void hessian(State state, Hessian kind, Scatter& scatter) override {
    const bool safe = kind == Hessian::safe, mixed = kind == Hessian::mixed;
    if (mixed && predicted_slope.empty()) throw std::logic_error("hessian: nothing was predicted");
    Jet jet;
    if constexpr (Model::bends) {
      compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
      if (mixed) slope = predicted_slope;
      for (int b = 0; b < blocks && kind == Hessian::exact; ++b) {
        Local w = local(b, state);
        evaluate<1>(b, w, jet);
        for (int lane = 0; lane < lanes_in(b); ++lane)
          for (int i = 0; i < 3; ++i)
            slope[3 * ((size_t)b * LANES + lane) + i] = jet.g[3 + i][lane] * w.hinge[i].factor[lane];
      }
    }
    scatter.clear();
    alignas(64) Real out[BLOCKS_LENGTH];
    for (int b = 0; b < blocks; ++b) {
      Local w = local(b, state);
      evaluate<2>(b, w, jet);
      if (safe) project_positive(jet.h);
      Real stress[3] = {jet.g[0], jet.g[1], jet.g[2]};
      for (int i = 0; i < 3 && mixed; ++i)
        for (int lane = 0; lane < LANES; ++lane) stress[i].p[lane] = predicted_tension[3 * triangle_at(b, lane) + i];
      fill_blocks(b, w, jet, stress, safe, out);
      for (int lane = 0; lane < lanes_in(b); ++lane)
        scatter.add<LANES>(b * LANES + lane, reinterpret_cast<const double*>(out), lane);
    }
  }

  void predict(State state, State direction) override {
    predicted_slope.assign(3 * (size_t)mesh.triangles, 0.0);
    predicted_tension.assign(3 * (size_t)mesh.triangles, 0.0);
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    Jet jet;
    for (int b = 0; b < blocks; ++b) {
      Local w = local(b, state);
      evaluate<2>(b, w, jet);
      Corners d = load(b, mesh.corner.data(), direction.displacement, nullptr);
      Vec3 own[3][3], across[3];
      if constexpr (Model::bends) alpha_gradient(w, own, across);
      Real rate[6];
      for (int i = 0; i < 3; ++i) {
        rate[i] = Real(2.0) * dot(w.t.e[i], d.x[(i + 2) % 3] - d.x[(i + 1) % 3]);
        rate[3 + i] = 0.0;
        if constexpr (Model::bends) {
          for (int j = 0; j < 3; ++j) rate[3 + i] += dot(own[i][j], d.x[j]);
          for (int lane = 0; lane < LANES; ++lane) {
            int half = 3 * triangle_at(b, lane) + i, other = mesh.across[half];
            double turn = Model::directors ? mesh.sign[half] * direction.director[mesh.edge[half]] : 0.0;
            const double* v = direction.displacement + 3 * (size_t)(other < 0 ? 0 : mesh.corner[other]);
            if (other >= 0) turn += across[i].x[lane] * v[0] + across[i].y[lane] * v[1] + across[i].z[lane] * v[2];
            rate[3 + i].p[lane] += turn;
          }
        }
      }
      for (int i = 0; i < 6; ++i) {
        Real stress = jet.g[i];
        for (int j = 0; j < 6; ++j) stress += jet.h[upper(i, j)] * rate[j];
        for (int lane = 0; lane < lanes_in(b); ++lane) {
          size_t at = 3 * ((size_t)b * LANES + lane) + i % 3;
          if (i < 3)
            predicted_tension[at] = stress[lane];
          else if (Model::bends)
            predicted_slope[at] = stress[lane] * w.hinge[i - 3].factor[lane];
        }
      }
    }
  }

  void turn_gradient(State state, const double* turn, double* gradient) override {
    for (int b = 0; b < blocks; ++b) {
      bool any = false;
      for (int k = 0; k < 3 * lanes_in(b); ++k) any = any || turn[3 * b * LANES + k] != 0.0;
      if (!any) continue;
      Triangle t = triangle_geometry(load(b, mesh.corner.data(), mesh.start.data(), state.displacement));
      for (int lane = 0; lane < lanes_in(b); ++lane)
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) {
            int k = 3 * (b * LANES + lane);
            add_lane(gradient, mesh.corner[k + j], (Real(turn[k + i]) * t.c[i][j]) * t.n, lane);
          }
    }
  }

  void mixed(State state, double* q_rest, double* q_fabric, double* fabric) override {
    using D = Dual<Real, 9>;
    using T = Dual<D, 6>;
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    for (int b = 0; b < blocks; ++b) {
      Local w = local(b, state);
      const Rest& r = rest[b];
      Invariants<T> q, qr;
      for (int i = 0; i < 3; ++i) {
        q.l[i] = T(D(w.q.l[i])), q.s[i] = T(D(w.q.s[i])), q.c[i] = T(D(w.q.c[i]));
        q.l[i].d[i] = D(1.0), q.s[i].d[3 + i] = D(w.q.c[i]), q.c[i].d[3 + i] = D(-w.q.s[i]);
        qr.l[i] = T(variable<9>(r.q.l[i], i));
        qr.s[i] = T(wave<9>(r.q.s[i], r.q.c[i], 3 + i)), qr.c[i] = T(wave<9>(r.q.c[i], -r.q.s[i], 3 + i));
      }
      Fabric<T> f{T(variable<9>(r.fabric.thickness, 6)), T(variable<9>(r.fabric.young, 7)),
                  T(variable<9>(r.fabric.poisson, 8))};
      auto e = model_energy<T>(q, w.dl, qr, f);
      for (int lane = 0; lane < lanes_in(b); ++lane) {
        size_t t = (size_t)b * LANES + lane;
        for (int i = 0; i < 6; ++i) {
          for (int j = 0; j < 6; ++j)
            q_rest[36 * t + 6 * i + j] = e.stretching.d[i].d[j][lane] + e.bending.d[i].d[j][lane];
          for (int j = 0; j < 3; ++j)
            q_fabric[18 * t + 3 * i + j] = e.stretching.d[i].d[6 + j][lane] + e.bending.d[i].d[6 + j][lane];
        }
        for (int j = 0; j < 3; ++j) fabric[3 * t + j] = e.stretching.v.d[6 + j][lane] + e.bending.v.d[6 + j][lane];
      }
    }
  }

  void invariants_jacobian(State state, double* jacobian) override {
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    for (int b = 0; b < blocks; ++b) store_jacobian(b, local(b, state), true, jacobian);
  }

  void rest_jacobian(double* jacobian) override {
    compute_facets(rest_corner.data(), rest_points.data(), nullptr);
    for (int b = 0; b < blocks; ++b) {
      Local w;
      w.t = triangle_geometry(load(b, rest_corner.data(), rest_points.data(), nullptr));
      compute_hinges(b, w, nullptr, false);
      store_jacobian(b, w, false, jacobian);
    }
  }

  void invariants(State state, double* lengths, double* angles) override {
    if constexpr (Model::bends) compute_facets(mesh.corner.data(), mesh.start.data(), state.displacement);
    for (int b = 0; b < blocks; ++b) {
      Local w = local(b, state);
      for (int lane = 0; lane < lanes_in(b); ++lane)
        for (int i = 0; i < 3; ++i) {
          lengths[3 * ((size_t)b * LANES + lane) + i] = w.q.l[i][lane];
          angles[3 * ((size_t)b * LANES + lane) + i] = std::atan2(w.q.s[i][lane], w.q.c[i][lane]);
        }
    }
  }
};

using Maker = std::unique_ptr<Elastic> (*)(Mesh);
template <class Model>
std::unique_ptr<Elastic> make(Mesh mesh) {
  return std::make_unique<ElasticModel<Model>>(std::move(mesh));
}

template <class Material>
void add_material(std::map<std::string, Maker>& table, const std::string& material) {
  table["koiter/average/" + material] = make<Koiter<Average, Material>>;
  table["koiter/sin/" + material] = make<Koiter<Sin, Material>>;
  table["koiter/tan/" + material] = make<Koiter<Tan, Material>>;
  table["koiter/theta/" + material] = make<Koiter<Theta, Material>>;
  table["membrane//" + material] = make<Membrane<Material>>;
}

std::unique_ptr<Elastic> make_elastic(const std::string& name, Mesh mesh) {
  static const auto table = [] {
    std::map<std::string, Maker> t;
    add_material<StVK>(t, "stvk");
    add_material<NeoHookean>(t, "neo-hookean");
    add_material<TensionField>(t, "tension-field");
    t["discrete-shells//"] = make<DiscreteShells>;
    return t;
  }();
  auto found = table.find(name);
  if (found == table.end()) throw std::invalid_argument("no elastic model " + name);
  return found->second(std::move(mesh));
}

}  // namespace VOILE_ISA
}  // namespace voile
