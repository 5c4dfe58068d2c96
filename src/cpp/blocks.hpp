// The mesh in blocks of LANES triangles, and the six invariants of a block with all that their derivatives
// need.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "elastic.hpp"
#include "geometry.hpp"
#include "models.hpp"

namespace voile {
inline namespace VOILE_ISA {

// Indices of a block; the last one repeats its last triangle, `count` lanes are real.
struct alignas(64) Block {
  int corner[3][LANES];  // 3*vertex
  int across[3][LANES];  // 3*vertex on the other side of edge i; the own corner on a boundary
  int edge[3][LANES];
  float sign[3][LANES];
  // dalpha_i = own (turn of this triangle) + other (turn of the neighbour): 1/2 each, 0 on a boundary; 1, 0
  // clamped
  float own[3][LANES];
  float side[3][LANES];  // sign of the sine of half the fold, 0 where it is within 180 degrees
  int first, count;
};

inline std::vector<Block> make_blocks(const Mesh& mesh, const int* corner) {
  std::vector<Block> blocks((mesh.triangles + LANES - 1) / LANES);
  for (size_t b = 0; b < blocks.size(); ++b) {
    Block& k = blocks[b];
    k.first = (int)b * LANES;
    k.count = std::min(LANES, mesh.triangles - k.first);
    for (int lane = 0; lane < LANES; ++lane)
      for (int i = 0; i < 3; ++i) {
        int half = 3 * (k.first + std::min(lane, k.count - 1)) + i, other = mesh.across[half];
        k.corner[i][lane] = 3 * corner[half];
        k.across[i][lane] = 3 * corner[other < 0 ? half : other];
        k.edge[i][lane] = mesh.edge[half];
        k.sign[i][lane] = (float)mesh.sign[half];
        k.own[i][lane] = other < 0 ? 0.0f : 0.5f;
        k.side[i][lane] = 0.0f;
      }
  }
  return blocks;
}

struct Local {
  Facet<3> t;
  Facet<1>
      next[3];  // across edge i, its first corner is the vertex across; normal t.n where own alone counts
  Real own[3], other[3];
  Invariants<Real> q;
  Vec3 area, edge[3], across[3];  // increases over the start shape: see Motion
  Increase<Real> over;            // of q over the rest shape; until `measure`, of l over the start shape
  Real s_rest[3], c_rest[3];      // sine and cosine of alpha at rest
  Real turned[3];                 // part of the director's angle that is in alpha already: see Clamp
};

// What increases count from. Angles are kept as tangents of their halves (alpha's magnitude is at most pi),
// in half the memory of sine and cosine: the memory's bandwidth limits the kernels.
struct Origin {
  Real t[3], root[3];  // of the start shape without directors: alpha, lengths of the edges
  Real t_rest[3];      // of the rest shape: alpha
  Real dl[3];          // l of the start shape less that of the rest shape
};

VOILE_INLINE Real half_tangent(const Real& s, const Real& c) {
  return lanewise(angle(s, c), [](double x) { return std::tan(0.5 * x); });
}

VOILE_INLINE Vec3 gather_point(const double* points, const int* at) {
  return {gather([=](int lane) { return points[at[lane]]; }),
          gather([=](int lane) { return points[at[lane] + 1]; }),
          gather([=](int lane) { return points[at[lane] + 2]; })};
}

// Adds an angle to another, both given by sine and cosine.
VOILE_INLINE void turn(Real& s, Real& c, const Real& sine, const Real& cosine) {
  Real was = s;
  s = was * cosine + c * sine;
  c = c * cosine - was * sine;
}

// alpha of edge i is turned by what the director angles are more than its clamp's.
VOILE_INLINE void turn_director(const Block& block, int i, const double* director, Local& w) {
  Real phi =
      widen(block.sign[i]) * gather([&](int lane) { return director[block.edge[i][lane]]; }) - w.turned[i];
  if (!any(phi.p != 0.0)) return;
  Real sine, cosine;
  sine_cosine(phi, sine, cosine);
  turn(w.q.s[i], w.q.c[i], sine, cosine);
  turn(w.over.s[i], w.over.c[i], sine, cosine);
}

template <bool bends>
VOILE_INLINE Local local_shape(const Block& block, const double* base, const double* displacement) {
  Local w;
  Vec3 x[3], u[3];
  // Positions from the first corner on, differences first: rounded in proportion to the triangle, not to its
  // place.
  const Vec3 origin = gather_point(base, block.corner[0]),
             shift = gather_point(displacement, block.corner[0]);
  for (int j = 0; j < 3; ++j) {
    u[j] = gather_point(displacement, block.corner[j]) - shift;
    x[j] = gather_point(base, block.corner[j]) - origin + u[j];
  }
  build_facet(x, w.t);
  for (int i = 0; i < 3; ++i) {
    Vec3 du = u[(i + 2) % 3] - u[(i + 1) % 3];
    w.edge[i] = du;
    w.over.l[i] = dot(du, w.t.e[i] + w.t.e[i] - du);
    w.q.l[i] = w.t.l[i];
    w.q.s[i] = w.over.s[i] = w.turned[i] = 0.0, w.q.c[i] = w.over.c[i] = 1.0;
  }
  if constexpr (bends) {
    w.area = w.t.inverse * (cross(w.edge[2], w.t.e[0]) + cross(w.t.e[2] - w.edge[2], w.edge[0]));
    for (int i = 0; i < 3; ++i) {
      Vec3 across = gather_point(base, block.across[i]) - origin;
      Vec3 moved = gather_point(displacement, block.across[i]) - shift;
      Vec3 y[3] = {across + moved, x[(i + 2) % 3], x[(i + 1) % 3]};
      build_facet(y, w.next[i]);
      w.across[i] = u[(i + 2) % 3] - moved;
      w.own[i] = widen(block.own[i]);
      auto shared = w.own[i].p == 0.5;
      w.other[i] = select(shared, Real(0.5), Real(0.0));
      Real s, c;
      half_fold(w.t.n, w.next[i].n, w.t.unit[i] * w.t.e[i], widen(block.side[i]), s, c);
      w.q.s[i] = select(shared, s, Real(0.0)), w.q.c[i] = select(shared, c, Real(1.0));
    }
  }
  return w;
}

// Increase of q over the rest shape: over the start shape, which at clamped half edges `hold_directors`
// knows, and the start shape's.
template <bool bends>
VOILE_INLINE void measure(const Origin& origin, Local& w) {
  for (int i = 0; i < 3; ++i) {
    if constexpr (bends) {
      const Real &s = w.q.s[i], &c = w.q.c[i];
      const Real &t = origin.t[i], &t_rest = origin.t_rest[i], one = 1.0;
      Real size = one + t * t, size_rest = one + t_rest * t_rest, both = one / (size * size_rest);
      Real scale = both * size_rest, s0 = (t + t) * scale, c0 = (one - t * t) * scale;
      scale = both * size;
      w.s_rest[i] = (t_rest + t_rest) * scale, w.c_rest[i] = (one - t_rest * t_rest) * scale;
      Motion d{w.area, w.edge[i], w.across[i], w.over.l[i] / (w.t.root[i] + origin.root[i])};
      Real cosine = c * c0 + s * s0;
      Real sine = half_turn(w.t, w.next[i], w.t.root[i], d, s, c, s0, c0, cosine);
      auto shared = w.other[i].p != 0.0;
      w.over.s[i] = select(shared, sine, w.over.s[i]), w.over.c[i] = select(shared, cosine, w.over.c[i]);
      // Nothing where start and rest are the same to the last digit.
      Real turned = (s0 - w.s_rest[i]) * w.c_rest[i] - (c0 - w.c_rest[i]) * w.s_rest[i];
      turn(w.over.s[i], w.over.c[i], turned, c0 * w.c_rest[i] + s0 * w.s_rest[i]);
    }
    w.over.l[i] += origin.dl[i];
  }
}

// Half the angles of the rest shape to clamps at rest; share: 1/2 where there is one, else 0.
struct Turn {
  Real s[3], c[3], share[3];
};

// Takes these angles off alpha.
VOILE_INLINE void turn_back(const Turn& turn, Invariants<Real>& q) {
  for (int i = 0; i < 3; ++i) {
    Real s = q.s[i] * turn.c[i] - q.c[i] * turn.s[i];
    q.c[i] = q.c[i] * turn.c[i] + q.s[i] * turn.s[i];
    q.s[i] = s;
  }
}

// Clamped half edges of the block: alpha is the whole angle from the normal to the held director, turned by
// the clamp's own angle; its increase over the start shape, which that angle does not enter: no round-off of
// it.
inline void hold_directors(const Block& block, const std::vector<int>& clamp_of,
                           const std::vector<Clamp>& clamps, Local& w) {
  for (int i = 0; i < 3; ++i) {
    // The held vector along normal and conormal, times the edge's length, and their increase.
    const Vec3 &n = w.t.n, &de = w.edge[i], e0 = w.t.e[i] - de;
    const Vec3 conormal = cross(w.t.e[i], n), dm = cross(de, n) + cross(e0, w.area);
    const Real droot = w.over.l[i] / (w.t.root[i] + sqrt(dot(e0, e0)));
    const Vec3 dn = w.t.root[i] * w.area + droot * (n - w.area);
    for (int lane = 0; lane < block.count; ++lane) {
      int held = clamp_of[3 * (block.first + lane) + i];
      if (held < 0) continue;
      const Clamp& k = clamps[held];
      auto along = [&](const Vec3& v) {
        return v.x[lane] * k.vector[0] + v.y[lane] * k.vector[1] + v.z[lane] * k.vector[2];
      };
      double n = w.t.root[i][lane] * along(w.t.n), m = along(conormal);
      double n0 = n - along(dn), m0 = m - along(dm);
      double size = std::hypot(n, m), both = size * std::hypot(n0, m0);
      double s = (k.conormal ? -n : m) / size, c = (k.conormal ? m : n) / size;
      double sine = std::sin(k.angle), cosine = std::cos(k.angle);
      w.q.s[i].p[lane] = s * cosine + c * sine, w.q.c[i].p[lane] = c * cosine - s * sine;
      w.turned[i].p[lane] = k.angle;
      w.over.s[i].p[lane] = (along(dm) * n0 - along(dn) * m0) / both;
      w.over.c[i].p[lane] = (m * m0 + n * n0) / both;
    }
  }
}

}  // namespace VOILE_ISA
}  // namespace voile
