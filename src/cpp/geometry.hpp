// Geometry of triangles in lanes: edges, normals, hinge half angles and their derivatives. Written once;
// every model uses it through the six invariants.
//
// Sign of the fold: positive where the surface is convex seen from the side its normals point to. With n the
// unit normal, e_i the edge opposite corner i, A the area: turning the triangle about edge i changes the fold
// by
//     d theta_i = sum_j c_ij n . dx_j,   c_ij = -e_i . e_j / (|e_i| 2A)
// and the triangle on the other side adds the same expression in its own corners, so that the gradient of an
// angle is a sum of two vector fields, each a function of one triangle, and its Hessian is a sum of two 9x9
// parts.
#pragma once

#include "pack.hpp"

namespace voile {
inline namespace VOILE_ISA {

// eps(j, k) = de_j/dx_k as a multiple of the identity: e_j = x_{j+2} - x_{j+1}.
constexpr double eps(int j, int k) { return k == (j + 2) % 3 ? 1.0 : (k == (j + 1) % 3 ? -1.0 : 0.0); }

// A triangle and what turning it about its first H edges does.
template <int H>
struct Facet {
  Vec3 e[3];  // edges
  Vec3 n;     // unit normal
  Real twice_area;
  Real l[H], root[H];  // squared lengths and lengths of the edges
  Real c[H][3];
};

template <int H>
VOILE_INLINE void build_facet(const Vec3 x[3], Facet<H>& t) {
  for (int i = 0; i < 3; ++i) t.e[i] = x[(i + 2) % 3] - x[(i + 1) % 3];
  Vec3 normal = cross(t.e[2], t.e[0]);
  t.twice_area = sqrt(dot(normal, normal));
  Real inverse = Real(1.0) / t.twice_area;
  t.n = inverse * normal;
  for (int i = 0; i < H; ++i) {
    t.l[i] = dot(t.e[i], t.e[i]);
    t.root[i] = sqrt(t.l[i]);
    Real scale = -inverse / t.root[i];
    for (int j = 0; j < 3; ++j) t.c[i][j] = scale * (i == j ? t.l[i] : dot(t.e[i], t.e[j]));
  }
}

// Sine and cosine of half the fold between unit normals n (left of the unit edge) and m.
VOILE_INLINE void half_fold(const Vec3& n, const Vec3& m, const Vec3& unit_edge, Real& s, Real& c) {
  Vec3 sum = n + m;
  Real length = max(sqrt(dot(sum, sum)), Real(1e-300));
  c = Real(0.5) * length;
  s = dot(cross(n, m), unit_edge) / length;
}

// P_jk of the triangle's part of sum_i weight_i Hess(theta_i): block (j, k) = (n P_jk^T + P_kj n^T)/2.
template <int H>
VOILE_INLINE void fold_hessian(const Facet<H>& t, const Real weight[H], Vec3 p[3][3]) {
  Real inverse = Real(1.0) / t.twice_area;
  Vec3 gradient[3], bent[H], turning{0.0, 0.0, 0.0};
  Real column[3] = {0.0, 0.0, 0.0};
  for (int i = 0; i < 3; ++i) gradient[i] = -inverse * cross(t.e[i], t.n);  // of the barycentric coordinate
  for (int i = 0; i < H; ++i) {
    Real unit = Real(1.0) / t.root[i];
    bent[i] = (weight[i] * unit * unit * unit) * cross(t.e[i], t.n);
    turning = turning + (weight[i] * unit * inverse) * t.e[i];
    for (int j = 0; j < 3; ++j) column[j] += weight[i] * t.c[i][j];
  }
  for (int j = 0; j < 3; ++j)
    for (int k = 0; k < 3; ++k) {
      Vec3 v = -column[j] * gradient[k] - column[k] * gradient[j];
      if (j != k) v = v - Real(eps(j, k)) * turning;
      for (int i = 0; i < H; ++i)
        if (i != j && i != k) v = v - Real(eps(i, j) * eps(i, k)) * bent[i];
      p[j][k] = v;
    }
}

}  // namespace VOILE_ISA
}  // namespace voile
