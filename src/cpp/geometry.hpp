// Geometry of triangles in lanes: edges, normals, hinge half angles and their derivatives. Written once; every
// model uses it through the six invariants.
//
// Sign of the fold: positive where the surface is convex seen from the side its normals point to. With n the unit
// normal, e_i the edge opposite corner i, A the area: turning the triangle about edge i changes the fold by
//     d theta_i = sum_j c_ij n . dx_j,   c_ij = -e_i . e_j / (|e_i| 2A)
// and the triangle on the other side adds the same expression in its own corners, so that the gradient of an angle
// is a sum of two vector fields, each a function of one triangle, and its Hessian is a sum of two 9x9 parts.
#pragma once

#include "pack.hpp"

namespace voile {
inline namespace VOILE_ISA {

// What a neighbour needs of a triangle: unit normal and the matrix c_ij above. One cache line and a half.
struct Facet {
  double n[3];
  double c[9];
};

// eps(j, k) = de_j/dx_k as a multiple of the identity: e_j = x_{j+2} - x_{j+1}.
constexpr double eps(int j, int k) { return k == (j + 2) % 3 ? 1.0 : (k == (j + 1) % 3 ? -1.0 : 0.0); }

struct Corners {
  Vec3 x[3];  // positions
  Vec3 u[3];  // displacements
};

struct Triangle {
  Vec3 e[3];         // edges
  Vec3 n;            // unit normal
  Real l[3], dl[3];  // squared lengths and their increase over the start shape
  Real root[3];      // edge lengths
  Real twice_area;
  Real c[3][3];
};

inline Triangle triangle_geometry(const Corners& p) {
  Triangle t;
  for (int i = 0; i < 3; ++i) {
    int a = (i + 1) % 3, b = (i + 2) % 3;
    t.e[i] = p.x[b] - p.x[a];
    Vec3 du = p.u[b] - p.u[a];
    t.l[i] = dot(t.e[i], t.e[i]);
    t.dl[i] = dot(du, t.e[i] + t.e[i] - du);
    t.root[i] = sqrt(t.l[i]);
  }
  Vec3 normal = cross(t.e[2], t.e[0]);
  t.twice_area = sqrt(dot(normal, normal));
  t.n = (Real(1.0) / t.twice_area) * normal;
  Real g[3];  // e_{i+1} . e_{i+2}
  for (int i = 0; i < 3; ++i) g[i] = dot(t.e[(i + 1) % 3], t.e[(i + 2) % 3]);
  for (int i = 0; i < 3; ++i) {
    Real scale = Real(-1.0) / (t.root[i] * t.twice_area);
    for (int j = 0; j < 3; ++j) t.c[i][j] = scale * (i == j ? t.l[i] : g[3 - i - j]);
  }
  return t;
}

// Sine and cosine of half the fold between unit normals n (left of the unit edge) and m.
inline void half_fold(const Vec3& n, const Vec3& m, const Vec3& unit_edge, Real& s, Real& c) {
  Vec3 sum = n + m;
  Real length = max(sqrt(dot(sum, sum)), Real(1e-300));
  c = Real(0.5) * length;
  s = dot(cross(n, m), unit_edge) / length;
}

// P_jk of the triangle's part of sum_i weight_i Hess(theta_i): block (j, k) = (n P_jk^T + P_kj n^T)/2.
inline void fold_hessian(const Triangle& t, const Real weight[3], Vec3 p[3][3]) {
  Real inverse = Real(1.0) / t.twice_area;
  Vec3 m[3], gradient[3], turning{0.0, 0.0, 0.0};
  Real column[3] = {0.0, 0.0, 0.0}, scaled[3];
  for (int i = 0; i < 3; ++i) {
    Real unit = Real(1.0) / t.root[i];
    m[i] = unit * cross(t.e[i], t.n);                             // unit conormal, outwards
    gradient[i] = (Real(-1.0) * t.root[i] * inverse) * m[i];      // of the barycentric coordinate
    turning = turning + (weight[i] * unit * inverse) * t.e[i];
    scaled[i] = weight[i] * unit * unit;
    for (int j = 0; j < 3; ++j) column[j] += weight[i] * t.c[i][j];
  }
  for (int j = 0; j < 3; ++j)
    for (int k = 0; k < 3; ++k) {
      Vec3 v = (Real(-1.0) * column[j]) * gradient[k] - column[k] * gradient[j];
      v = v - Real(eps(j, k)) * turning;
      for (int i = 0; i < 3; ++i)
        if (i != j && i != k) v = v - (Real(eps(i, j) * eps(i, k)) * scaled[i]) * m[i];
      p[j][k] = v;
    }
}

}  // namespace VOILE_ISA
}  // namespace voile
