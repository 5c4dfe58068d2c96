// Sparse Cholesky factors for very many solves with three right-hand sides.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace voile {

// A supernode: `width` columns from place `first` on, and its rows, its own first, in `strips` of eight, of
// which the last is filled up with rows of zeros at the place behind all. panel (strips, width, 8): with its
// columns of L (L1; L2) it is (1; -L2) L1^-1, so that no entry of a solve waits for another.
struct Node {
  int first, width, strips;
  const int32_t* rows;
  const float* panel;
};

// L L^T of a symmetric positive definite matrix, in the supernodes of `Definite`, kept and solved with in
// single precision: for iterations whose right-hand sides are residuals, for which it changes the way, not
// the end. A motion of all unknowns alike is told apart in double precision, so that what falls flat stays
// flat. Three right-hand sides are solved for at once: 0.19 ms at 5,929 vertices; in double precision 0.28,
// and far more where others crowd the cache.
class Cholesky {
 public:
  // Rows of the matrix, both triangles, columns ascending; places (sides, size), at most 3 sides: where the
  // right-hand sides are. Throws std::runtime_error where it is not positive definite.
  Cholesky(int size, const int32_t* start, const int32_t* column, const double* value, int sides,
           const int32_t* places);

  // x = A^-1 b, to some 1e-6, at the places; nothing else is read or written.
  void solve(const double* b, double* x);
  size_t least() const { return furthest + 1; }             // numbers in b
  double nonzeros() const { return (double)panel.size(); }  // of the supernodes

 private:
  int sides;
  size_t furthest;
  std::vector<int32_t> place;  // (size, sides) in b and x, in the factor's order
  std::vector<double> sums;    // of these rows, and of them all
  double total;
  std::vector<int32_t> rows;  // of all supernodes
  std::vector<float> panel;
  std::vector<Node> nodes;
  std::vector<float> work, values;  // (size + 1, 4); of a supernode's rows (strips, 3, 8)
};

}  // namespace voile
