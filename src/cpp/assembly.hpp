// From derivatives of W with respect to the invariants to those with respect to positions and directors:
// gradient J^T W_q, Hessian J^T W_qq J + sum_k W_qk Hess(q_k), by blocks of triangles.
#pragma once

#include "blocks.hpp"
#include "density.hpp"
#include "scatter.hpp"

namespace voile {
inline namespace VOILE_ISA {

inline void add_lane(double* target, const Vec3& v, int lane) {
  target[0] += v.x[lane];
  target[1] += v.y[lane];
  target[2] += v.z[lane];
}

// dalpha_i/dx of the own corners and of the vertex across edge i.
VOILE_INLINE void alpha_gradient(const Local& w, Vec3 own[3][3], Vec3 across[3]) {
  for (int i = 0; i < 3; ++i) {
    const Facet<1>& f = w.next[i];
    for (int j = 0; j < 3; ++j) own[i][j] = (w.own[i] * w.t.c[i][j]) * w.t.n;
    Vec3 n = w.other[i] * f.n;
    across[i] = f.c[0][0] * n;
    own[i][(i + 2) % 3] = own[i][(i + 2) % 3] + f.c[0][1] * n;
    own[i][(i + 1) % 3] = own[i][(i + 1) % 3] + f.c[0][2] * n;
  }
}

template <class Model>
VOILE_INLINE void add_gradient(const Block& block, const Local& w, const Jet& jet, double* gradient,
                               double* edge_gradient) {
  Vec3 force[3], across[3];
  for (int j = 0; j < 3; ++j) {
    int a = (j + 1) % 3, b = (j + 2) % 3;  // edges at corner j: dl_a/dx_j = 2 e_a, dl_b/dx_j = -2 e_b
    force[j] = (Real(2.0) * jet.g[a]) * w.t.e[a] - (Real(2.0) * jet.g[b]) * w.t.e[b];
  }
  if constexpr (Model::bends) {
    Real turning[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; ++i) {
      Real moment = w.own[i] * jet.g[3 + i];
      for (int j = 0; j < 3; ++j) turning[j] += moment * w.t.c[i][j];
      const Facet<1>& f = w.next[i];
      Vec3 m = (w.other[i] * jet.g[3 + i]) * f.n;
      across[i] = f.c[0][0] * m;
      force[(i + 2) % 3] = force[(i + 2) % 3] + f.c[0][1] * m;
      force[(i + 1) % 3] = force[(i + 1) % 3] + f.c[0][2] * m;
    }
    for (int j = 0; j < 3; ++j) force[j] = force[j] + turning[j] * w.t.n;
  }
  for (int lane = 0; lane < block.count; ++lane)
    for (int i = 0; i < 3; ++i) {
      add_lane(gradient + block.corner[i][lane], force[i], lane);
      if constexpr (Model::bends) add_lane(gradient + block.across[i][lane], across[i], lane);
      if constexpr (Model::directors)
        edge_gradient[block.edge[i][lane]] += (double)block.sign[i][lane] * jet.g[3 + i][lane];
    }
}

struct Mat3 {
  Real m[9] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  VOILE_INLINE void add(const Vec3& row, const Vec3& column) {
    m[0] += row.x * column.x, m[1] += row.x * column.y, m[2] += row.x * column.z;
    m[3] += row.y * column.x, m[4] += row.y * column.y, m[5] += row.y * column.z;
    m[6] += row.z * column.x, m[7] += row.z * column.y, m[8] += row.z * column.z;
  }
  // Block (j, k) of a fold's Hessian from fold_hessian; half_n: half the normal.
  VOILE_INLINE void add_fold(const Vec3& half_n, const Vec3 p[3][3], int j, int k) {
    add(half_n, p[j][k]);
    add(p[k][j], half_n);
  }
  VOILE_INLINE void store(Real* out) const {
    for (int k = 0; k < 9; ++k) out[k] = m[k];
  }
};

// Hessians of the folds, weighted: of this triangle's own turn and of its three neighbours'.
struct FoldHessian {
  Vec3 half_n, p[3][3];
  Vec3 half_next[3], next[3][3][3];

  VOILE_INLINE FoldHessian(const Local& w, const Real own_weight[3], const Real other_weight[3]) {
    half_n = Real(0.5) * w.t.n;
    fold_hessian(w.t, own_weight, p);
    for (int i = 0; i < 3; ++i) {
      half_next[i] = Real(0.5) * w.next[i].n;
      fold_hessian(w.next[i], other_weight + i, next[i]);
    }
  }
  // A corner's place in the neighbour across edge i.
  static int place(int i, int corner) { return corner == (i + 2) % 3 ? 1 : 2; }
};

// Rows and columns of the director angles.
VOILE_INLINE void fill_directors(const Block& block, const Real h[21], const Vec3 across[3],
                                 const Vec3 columns[6][3], Real* out) {
  Real sign[3];
  for (int i = 0; i < 3; ++i) sign[i] = widen(block.sign[i]);
  auto store = [out](int a, int b, const Vec3& v) {
    Real* o = out + BLOCKS.start[a][b];
    o[0] = v.x, o[1] = v.y, o[2] = v.z;
  };
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) {
      store(k, 6 + i, sign[i] * columns[3 + i][k]);
      store(3 + k, 6 + i, (sign[i] * h[upper(3 + i, 3 + k)]) * across[k]);
      if (k >= i) *(out + BLOCKS.start[6 + i][6 + k]) = sign[i] * sign[k] * h[upper(3 + i, 3 + k)];
    }
}

// The tensile part of a triangle's geometric stiffness, sum_i t_i |du_i|^2 over edges: the stress sum_i t_i
// e_i e_i^T without its negative principal stress. Negative t_i alone say nothing: a pull across no edge has
// some, too. A metric of slivers serves as well as theirs: whatever it is, no less than the stiffness is
// left, and no negative one.
VOILE_INLINE void tensile(const Vec3 e[3], Real t[3]) {
  Real a = sqrt(max(dot(e[1], e[1]), Real(1e-300))), b = dot(e[1], e[2]) / a;
  Real c = max(sqrt(max(dot(e[2], e[2]) - b * b, Real(0.0))), Real(1e-6) * a);
  Real m = t[1] + t[0], n = t[2] + t[0];  // sum_i t_i d_i^2 = m d_1^2 + 2 t_0 d_1 d_2 + n d_2^2
  Real x = m * a * a + Real(2.0) * t[0] * a * b + n * b * b, z = n * c * c, y = (t[0] * a + n * b) * c;
  // With S = (x y; y z): (S + |S|)/2, where |S| = (S^2 + |det S|)/sqrt(tr S^2 + 2 |det S|).
  Real det = x * z - y * y, size = max(det, -det);
  Real root = sqrt(max(x * x + Real(2.0) * y * y + z * z + Real(2.0) * size, Real(1e-300)));
  Real p = Real(0.5) * (x + (x * x + y * y + size) / root),
       r = Real(0.5) * (z + (z * z + y * y + size) / root);
  Real q = Real(0.5) * y * (Real(1.0) + (x + z) / root);
  t[0] = (q - b / c * r) / (a * c);
  t[1] = (p - Real(2.0) * b / c * q + b * b / (c * c) * r) / (a * a) - t[0];
  t[2] = r / (c * c) - t[0];
}

// Upper blocks of the triangles' Hessians in the layout of scatter.hpp. tension: dW/dl of the geometric part;
// folds: null leaves the fold's part out.
template <class Model>
VOILE_INLINE void fill_blocks(const Block& block, const Local& w, const Real h[21], const Real tension[3],
                              const FoldHessian* folds, Real* out) {
  constexpr int M = Model::bends ? 6 : 3;
  Vec3 own[3][3], across[3], columns[M][3];  // columns: W_qq J
  if constexpr (Model::bends) alpha_gradient(w, own, across);
  for (int p = 0; p < M; ++p)
    for (int j = 0; j < 3; ++j) {
      int a = (j + 1) % 3, b = (j + 2) % 3;
      columns[p][j] = (Real(2.0) * h[upper(p, a)]) * w.t.e[a] - (Real(2.0) * h[upper(p, b)]) * w.t.e[b];
      if constexpr (Model::bends)
        for (int i = 0; i < 3; ++i) columns[p][j] = columns[p][j] + h[upper(p, 3 + i)] * own[i][j];
    }
  for (int j = 0; j < 3; ++j)
    for (int k = j; k < 3; ++k) {
      Mat3 m;
      int a = (j + 1) % 3, b = (j + 2) % 3;
      m.add(Real(2.0) * w.t.e[a], columns[a][k]);
      m.add(Real(-2.0) * w.t.e[b], columns[b][k]);
      if constexpr (Model::bends) {
        for (int i = 0; i < 3; ++i) m.add(own[i][j], columns[3 + i][k]);
        if (folds) {
          m.add_fold(folds->half_n, folds->p, j, k);
          for (int i = 0; i < 3; ++i)
            if (i != j && i != k)
              m.add_fold(folds->half_next[i], folds->next[i], FoldHessian::place(i, j),
                         FoldHessian::place(i, k));
        }
      }
      Real pull = j == k ? Real(2.0) * (tension[a] + tension[b]) : Real(-2.0) * tension[3 - j - k];
      m.m[0] += pull, m.m[4] += pull, m.m[8] += pull;
      m.store(out + BLOCKS.start[j][k]);
    }
  if constexpr (Model::bends) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) {
        Mat3 m;
        m.add(columns[3 + i][j], across[i]);
        if (folds && i != j) m.add_fold(folds->half_next[i], folds->next[i], FoldHessian::place(i, j), 0);
        m.store(out + BLOCKS.start[j][3 + i]);
      }
      for (int k = i; k < 3; ++k) {
        Mat3 m;
        m.add(h[upper(3 + i, 3 + k)] * across[i], across[k]);
        if (folds && i == k) m.add_fold(folds->half_next[i], folds->next[i], 0, 0);
        m.store(out + BLOCKS.start[3 + i][3 + k]);
      }
    }
    if constexpr (Model::directors) fill_directors(block, h, across, columns, out);
  }
}

// dq/dx (6, 21) of each triangle of the block; without angles their rows are zero.
template <class Model>
inline void store_jacobian(const Block& block, const Local& w, bool angles, bool directors,
                           double* jacobian) {
  Vec3 own[3][3], across[3];
  if constexpr (Model::bends) alpha_gradient(w, own, across);
  for (int lane = 0; lane < block.count; ++lane) {
    double* out = jacobian + (size_t)126 * (block.first + lane);
    std::fill(out, out + 126, 0.0);
    for (int i = 0; i < 3; ++i) {
      double* row = out + 21 * i;
      for (int j = 0; j < 3; ++j)
        if (i != j) add_lane(row + 3 * j, Real(2.0 * eps(i, j)) * w.t.e[i], lane);
      if (!Model::bends || !angles) continue;
      row += 21 * 3;
      for (int j = 0; j < 3; ++j) add_lane(row + 3 * j, own[i][j], lane);
      add_lane(row + 9 + 3 * i, across[i], lane);
      if (directors) row[18 + i] = block.sign[i][lane];
    }
  }
}

// Whether symmetric matrices are positive definite by a margin, in every lane: the pivots of L D L^T.
template <int N>
inline bool positive(const Real matrix[N][N]) {
  Real a[N][N];
  std::memcpy(a, matrix, sizeof a);
  Mask all = Mask{} == 0;
  for (int k = 0; k < N; ++k) {
    all &= a[k][k].p > 1e-10;
    for (int i = k + 1; i < N; ++i) {
      Real factor = a[k][i] / a[k][k];
      for (int j = i; j < N; ++j) a[i][j] -= factor * a[k][j];
    }
  }
  return !any(~all);
}

// Projects the leading NxN part of W_qq on the positive semidefinite cone: cyclic Jacobi rotations in a basis
// scaled by the diagonal, negative eigenvalues set to zero.
template <int N>
inline void project_positive(Real h[21]) {
  Real a[N][N], v[N][N], scale[N];
  for (int i = 0; i < N; ++i) {
    Real d = h[upper(i, i)];
    scale[i] = sqrt(max(max(d, -d), Real(1e-300)));
  }
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      a[i][j] = h[upper(i, j)] / (scale[i] * scale[j]);
      v[i][j] = i == j ? 1.0 : 0.0;
    }
  if (positive<N>(a)) return;
  for (int sweep = 0; sweep < 8; ++sweep) {
    Mask left = Mask{} != 0;  // lanes with an entry off the diagonal that counts
    for (int p = 0; p < N - 1; ++p)
      for (int q = p + 1; q < N; ++q) {
        Real off = a[p][q];
        Mask small = (off.p < 1e-16) & (off.p > -1e-16);
        if (!any(~small)) continue;
        left |= ~small;
        Real ratio = (a[q][q] - a[p][p]) / (Real(2.0) * select(small, Real(1.0), off));
        Real size = max(ratio, -ratio);
        Real tangent = Real(1.0) / (size + sqrt(ratio * ratio + Real(1.0)));
        tangent = select(ratio.p < 0.0, -tangent, tangent);
        tangent = select(small, Real(0.0), tangent);
        Real c = Real(1.0) / sqrt(tangent * tangent + Real(1.0)), s = tangent * c;
        for (int k = 0; k < N; ++k) {
          Real x = a[k][p], y = a[k][q];
          a[k][p] = c * x - s * y;
          a[k][q] = s * x + c * y;
        }
        for (int k = 0; k < N; ++k) {
          Real x = a[p][k], y = a[q][k];
          a[p][k] = c * x - s * y;
          a[q][k] = s * x + c * y;
          x = v[k][p], y = v[k][q];
          v[k][p] = c * x - s * y;
          v[k][q] = s * x + c * y;
        }
      }
    if (!any(left)) break;
  }
  for (int i = 0; i < N; ++i)
    for (int j = i; j < N; ++j) {
      Real sum = 0.0;
      for (int k = 0; k < N; ++k) sum += max(a[k][k], Real(0.0)) * v[i][k] * v[j][k];
      h[upper(i, j)] = sum * scale[i] * scale[j];
    }
}

// A share of the derivatives of W without negative curvature, the rest exact.
template <int N>
inline void make_safe(const Vec3 e[3], double share, Jet& jet, Real tension[3]) {
  const Jet exact = jet;
  const Real safe = share, rest = 1.0 - share;
  project_positive<N>(jet.h);
  tensile(e, tension);
  if (share == 1.0) return;
  for (int i = 0; i < 21; ++i) jet.h[i] = safe * jet.h[i] + rest * exact.h[i];
  for (int i = 0; i < 3; ++i) tension[i] = safe * tension[i] + rest * exact.g[i];
}

}  // namespace VOILE_ISA
}  // namespace voile
