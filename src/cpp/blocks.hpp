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
  float own[3][LANES], other[3][LANES];
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
        k.own[i][lane] = k.other[i][lane] = other < 0 ? 0.0f : 0.5f;
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
  Real dl[3];  // increase of the squared lengths over the start shape
};

VOILE_INLINE Vec3 gather_point(const double* points, const int* at) {
  return {gather([=](int lane) { return points[at[lane]]; }),
          gather([=](int lane) { return points[at[lane] + 1]; }),
          gather([=](int lane) { return points[at[lane] + 2]; })};
}

// alpha of edge i is turned by the director angles.
VOILE_INLINE void turn_director(const Block& block, int i, const double* director, Invariants<Real>& q) {
  Real phi = widen(block.sign[i]) * gather([&](int lane) { return director[block.edge[i][lane]]; });
  if (!any(phi.p != 0.0)) return;
  Real sine, cosine, s = q.s[i], c = q.c[i];
  sine_cosine(phi, sine, cosine);
  q.s[i] = s * cosine + c * sine;
  q.c[i] = c * cosine - s * sine;
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
    w.dl[i] = dot(du, w.t.e[i] + w.t.e[i] - du);
    w.q.l[i] = w.t.l[i];
    w.q.s[i] = 0.0, w.q.c[i] = 1.0;
  }
  if constexpr (bends)
    for (int i = 0; i < 3; ++i) {
      Vec3 across = gather_point(base, block.across[i]) - origin;
      across = across + (gather_point(displacement, block.across[i]) - shift);
      Vec3 y[3] = {across, x[(i + 2) % 3], x[(i + 1) % 3]};
      build_facet(y, w.next[i]);
      w.own[i] = widen(block.own[i]), w.other[i] = widen(block.other[i]);
      auto shared = w.other[i].p != 0.0;
      Real s, c;
      half_fold(w.t.n, w.next[i].n, (Real(1.0) / w.t.root[i]) * w.t.e[i], s, c);
      w.q.s[i] = select(shared, s, Real(0.0)), w.q.c[i] = select(shared, c, Real(1.0));
    }
  return w;
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

// Clamped half edges of the block: alpha is the whole angle from the normal to the held director.
inline void hold_directors(const Block& block, const std::vector<int>& clamp_of,
                           const std::vector<Clamp>& clamps, Local& w) {
  for (int i = 0; i < 3; ++i) {
    Vec3 conormal = (Real(1.0) / w.t.root[i]) * cross(w.t.e[i], w.t.n);
    for (int lane = 0; lane < block.count; ++lane) {
      int held = clamp_of[3 * (block.first + lane) + i];
      if (held < 0) continue;
      const Clamp& k = clamps[held];
      auto along = [&](const Vec3& v) {
        return v.x[lane] * k.vector[0] + v.y[lane] * k.vector[1] + v.z[lane] * k.vector[2];
      };
      double n = along(w.t.n), m = along(conormal), s = k.conormal ? -n : m, c = k.conormal ? m : n;
      double size = std::hypot(s, c);
      w.q.s[i].p[lane] = s / size, w.q.c[i].p[lane] = c / size;
    }
  }
}

}  // namespace VOILE_ISA
}  // namespace voile
