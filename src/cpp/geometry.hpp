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
  Vec3 e[3];                    // edges
  Vec3 n;                       // unit normal
  Real twice_area, inverse;     // and 1/twice_area
  Real l[H], root[H], unit[H];  // squared lengths and lengths of the edges, 1/lengths
  Real c[H][3];
};

template <int H>
VOILE_INLINE void build_facet(const Vec3 x[3], Facet<H>& t) {
  for (int i = 0; i < 3; ++i) t.e[i] = x[(i + 2) % 3] - x[(i + 1) % 3];
  Vec3 normal = cross(t.e[2], t.e[0]);
  t.twice_area = sqrt(dot(normal, normal));
  t.inverse = Real(1.0) / t.twice_area;
  t.n = t.inverse * normal;
  for (int i = 0; i < H; ++i) {
    t.l[i] = dot(t.e[i], t.e[i]);
    t.root[i] = sqrt(t.l[i]);
    t.unit[i] = Real(1.0) / t.root[i];
    Real scale = -t.inverse * t.unit[i];
    for (int j = 0; j < 3; ++j) t.c[i][j] = scale * (i == j ? t.l[i] : dot(t.e[i], t.e[j]));
  }
}

// Sine and cosine of half the fold between unit normals n (left of the unit edge) and m. The fold is within
// 180 degrees, but where `side` gives the sign that the sine has: there it goes on through them. The larger
// of the two is a length, so both keep their digits at 180 degrees as well.
VOILE_INLINE void half_fold(const Vec3& n, const Vec3& m, const Vec3& unit_edge, const Real& side, Real& s,
                            Real& c) {
  const auto sharp = dot(n, m).p < 0.0;
  const Vec3 longer = select(sharp, n - m, n + m);
  const Real length = sqrt(dot(longer, longer)), half = Real(0.5) * length;
  const Real smaller = dot(cross(n, m), unit_edge) / length;  // of the sine's sign
  const auto left = smaller.p < 0.0;
  s = select(sharp, select(left, Real(0.0) - half, half), smaller);
  c = select(sharp, select(left, Real(0.0) - smaller, smaller), half);
  const auto other = (s * side).p < 0.0;
  s = select(other, Real(0.0) - s, s), c = select(other, Real(0.0) - c, c);
}

// What a triangle, its neighbour across an edge and that edge have changed by since the start shape.
struct Motion {
  Vec3 area;    // of twice_area n, over the present twice_area
  Vec3 edge;    // of the edge
  Vec3 across;  // of the neighbour's edge from the vertex across to the edge's end
  Real root;    // of the edge's length
};

// Sine of the increase of half a fold over the start shape, of which s0 and c0 are sine and cosine; s and c
// are those now, cosine is the increase's. A difference of angles would round in proportion to the angles;
// here every term is proportional to the motion. With N and M the triangles' normals as long as twice their
// areas, E their edge and b the neighbour's edge of `Motion`, N x M = E (N.b): sin(fold) and cos(fold) are
// |E| N.b and N.M over |N||M|, and sin(fold - fold0) is made of their increases.
template <int H>
VOILE_INLINE Real half_turn(const Facet<H>& t, const Facet<1>& next, const Real& root, const Motion& d,
                            const Real& s, const Real& c, const Real& s0, const Real& c0,
                            const Real& cosine) {
  Vec3 b0 = next.e[2] - d.across;
  Vec3 turned = cross(d.across, next.e[0]) - cross(b0, d.edge);  // of M
  Real height = dot(t.n, next.e[2]), risen = dot(t.n, d.across) + dot(d.area, b0);
  Real ds = (risen * root + (height - risen) * d.root) * next.inverse;
  Real dc = dot(d.area, next.n) + dot(t.n - d.area, turned) * next.inverse;
  Real twice = ds * (c0 * c0 - s0 * s0) - dc * (Real(2.0) * s0 * c0);
  return select(cosine.p > 0.5, twice / (cosine + cosine), s * c0 - c * s0);
}

// P_jk of the triangle's part of sum_i weight_i Hess(theta_i): block (j, k) = (n P_jk^T + P_kj n^T)/2.
template <int H>
VOILE_INLINE void fold_hessian(const Facet<H>& t, const Real weight[H], Vec3 p[3][3]) {
  Vec3 gradient[3], bent[H], turning{0.0, 0.0, 0.0};
  Real column[3] = {0.0, 0.0, 0.0};
  for (int i = 0; i < 3; ++i) gradient[i] = -t.inverse * cross(t.e[i], t.n);  // of the barycentric coordinate
  for (int i = 0; i < H; ++i) {
    Real unit = t.unit[i];
    bent[i] = (weight[i] * unit * unit * unit) * cross(t.e[i], t.n);
    turning = turning + (weight[i] * unit * t.inverse) * t.e[i];
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
