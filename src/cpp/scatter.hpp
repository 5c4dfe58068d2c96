// From triangle blocks to a sparse matrix whose pattern is fixed once: every block's place is looked up
// beforehand.
//
// Nodes are vertices (three displacements) and edges (one director angle). Their degrees of freedom are
// affine in the unknowns, dof = C unknown + lift (supports, seams); C is the identity for nearly all nodes,
// and the triangles whose nodes are all plain (identity) or absent (eliminated) take the fast path, the
// others expand C.
#pragma once

#include <algorithm>
#include <climits>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "elastic.hpp"

namespace voile {

constexpr int NODES = 9;  // three corners, three vertices across the edges, three edges
constexpr int DOFS = 21;
constexpr int ABSENT = INT_MIN;
constexpr int ALL = -1;  // parts

// First local degree of freedom of a node's place in a triangle, and the number of them.
constexpr int node_dof(int a) { return a < 6 ? 3 * a : 12 + a; }
constexpr int node_size(int a) { return a < 6 ? 3 : 1; }

// Start of block (a, b), a <= b, in the packed upper triangle of blocks; row-major inside a block.
constexpr int block_start(int a, int b) {
  int start = 0;
  for (int i = 0; i < NODES; ++i)
    for (int j = i; j < NODES; ++j) {
      if (i == a && j == b) return start;
      start += node_size(i) * node_size(j);
    }
  return start;
}
constexpr int BLOCKS_LENGTH = block_start(NODES, NODES);

struct BlockTable {
  int start[NODES][NODES] = {};
  constexpr BlockTable() {
    for (int a = 0; a < NODES; ++a)
      for (int b = a; b < NODES; ++b) start[a][b] = start[b][a] = block_start(a, b);
  }
};
inline constexpr BlockTable BLOCKS{};

// Compressed sparse rows as PETSc keeps them (32-bit indices), values written in place.
struct Rows {
  const int* start = nullptr;
  const int* column = nullptr;
  double* value = nullptr;
};

struct Scatter {
  int owned = 0;                   // rows of this rank: local unknowns [0, owned)
  int nodes = NODES;               // 6 without edge unknowns
  std::vector<int> triangle_node;  // (m, 9) node index, -1 absent; vertices first, then edges
  std::vector<int> first;          // per node: first unknown if plain, -1 eliminated, -2 otherwise
  std::vector<int> dof_start, dof_unknown;
  std::vector<double> dof_weight;  // C in compressed rows, dofs: 3*vertex + axis, then edges
  int vertices = 0;
  std::vector<char> plain;    // per triangle
  std::vector<int> position;  // per triangle nodes*nodes places
  std::vector<int> fresh_start,
      fresh;  // per triangle: runs of rows (begin, end) that it is the first to touch
  // Threads share out the rows of a fresh assembly: each takes a run of triangles, and the rows that these
  // are the first to touch. So all entries are summed in the order of the triangles, whatever the threads.
  int parts = 1, run = INT_MAX;   // how many, and the triangles of each
  std::vector<uint8_t> part;      // of rows
  std::vector<uint8_t> touched;   // per triangle: parts whose rows it touches, a bit each
  std::vector<int> ghost_column;  // local unknown - owned -> column of the off-rank part
  Rows inside, outside;           // columns of this rank, and of the others
  bool adding = false;            // a fresh assembly adds to the values there

  Scatter(const Mesh& mesh, bool with_edges, int owned_unknowns, std::vector<int> c_start,
          std::vector<int> c_unknown, std::vector<double> c_weight, int threads);

  // Pattern of the owned rows in local unknowns, sorted by rank[unknown] (the global number).
  void pattern(const int64_t* rank, std::vector<int64_t>& start, std::vector<int>& column) const;
  void bind(Rows inside_rows, Rows outside_rows, std::vector<int> ghost_columns);
  // A fresh assembly visits the triangles in order: each zeroes the rows it is the first to touch, which are
  // then in the cache when they are added to; clear() zeroes those that no triangle touches.
  void clear();
  int count() const { return (int)(triangle_node.size() / NODES); }  // triangles
  // Whether one of these triangles has rows of a part.
  bool visits(int mine, int begin, int end) const {
    return std::any_of(touched.begin() + begin, touched.begin() + end,
                       [mine](uint8_t bits) { return bits >> mine & 1; });
  }
  void open(int t, int mine = ALL) {
    if (mine == ALL || t / run == mine) zero_fresh(t);
  }

  // Adds a 3x3 block (row-major, any) to the degrees of freedom of one vertex; part of every pattern.
  void add_vertex(int vertex, const double* block);

  // Adds a DOFS x DOFS block (row-major, not symmetric) to triangle t's degrees of freedom.
  void add_square(int t, const double* block);

  // Adds lane `lane` of a buffer of BLOCKS_LENGTH packs of L doubles, the upper blocks of triangle t's
  // Hessian, to the rows of a part.
  template <int L>
  void add(int t, const double* buffer, int lane, int mine = ALL) {
    if (!plain[t]) {
      double block[BLOCKS_LENGTH];
      for (int k = 0; k < BLOCKS_LENGTH; ++k) block[k] = buffer[k * L + lane];
      add_expanded(t, block, mine);
      return;
    }
    const int* node = &triangle_node[(size_t)NODES * t];
    const int* place = &position[(size_t)nodes * nodes * t];
    for (int a = 0; a < nodes; ++a, place += nodes) {
      int row = node[a] < 0 ? -1 : first[node[a]];
      if (row < 0 || !has(row, mine)) continue;
      if (a < 6)
        add_rows<L, 3>(a, row, place, buffer + lane);
      else
        add_rows<L, 1>(a, row, place, buffer + lane);
    }
  }

 private:
  // The R rows of node a.
  template <int L, int R>
  void add_rows(int a, int row, const int* place, const double* source) {
    double *in[R], *out[R] = {};
    for (int r = 0; r < R; ++r) {
      in[r] = inside.value + inside.start[row + r];
      if (outside.start) out[r] = outside.value + outside.start[row + r];
    }
    for (int b = 0; b < 6; ++b, ++place)
      add_block<L, R, 3>(in, out, *place, source + BLOCKS.start[a][b] * L, a <= b);
    for (int b = 6; b < nodes; ++b, ++place)
      add_block<L, R, 1>(in, out, *place, source + BLOCKS.start[a][b] * L, a <= b);
  }
  template <int L, int R, int C>
  static inline __attribute__((always_inline)) void add_block(double* const* in, double* const* out, int at,
                                                              const double* source, bool upper) {
    if (at == ABSENT) return;
    double* const* rows = at >= 0 ? in : out;
    if (at < 0) at = ~at;
    const int down = (upper ? C : 1) * L, along = (upper ? 1 : R) * L;  // the block as stored or transposed
    double v[R][C];
    for (int r = 0; r < R; ++r)
      for (int c = 0; c < C; ++c) v[r][c] = rows[r][at + c] + source[r * down + c * along];
    for (int r = 0; r < R; ++r)
      for (int c = 0; c < C; ++c) rows[r][at + c] = v[r][c];
  }
  bool has(int row, int mine) const { return row < owned && (mine == ALL || part[row] == mine); }
  void zero_fresh(int t);
  void order_rows();
  void add_expanded(int t, const double* block, int mine);
  // Adds entry(i, j) of the triangle's degrees of freedom through C.
  template <class Entry>
  void expand(int t, int dofs, int mine, Entry entry);
  double& at(int row, int unknown);
  int find(int row, int unknown) const;  // place in the row as in position, ABSENT if not there
  int triangle_dof(int t, int k) const;  // global dof of the triangle's k-th, -1 absent
};

}  // namespace voile
