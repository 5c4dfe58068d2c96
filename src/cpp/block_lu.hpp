// Sparse LU of matrices of 3 by 3 blocks by the multifrontal method (Duff & Reid 1983), with BLAS and LAPACK.
//
// The symbolic phase is done once per pattern: order (approximate minimum degree), elimination tree,
// supernodes. Each factorisation may leave out block rows and columns: its fronts just shrink. Pivots are
// sought among the rows of a front that are complete.
#pragma once

#include <span>
#include <vector>

namespace voile {

class BlockLU {
 public:
  // n block rows; pattern in compressed rows, with the diagonal. Throws std::runtime_error if it is
  // malformed.
  BlockLU(int n, std::span<const int> start, std::span<const int> column);

  // blocks: (nonzeros, 3, 3) row-major, in the pattern's order; block rows and columns where `active` is zero
  // do not take part. Returns false if a pivot is zero or not finite.
  bool factor(std::span<const double> blocks, std::span<const char> active);

  // x (n, 3): the right-hand side, then the solution; entries that do not take part stay as they are.
  void solve(std::span<double> x) const;

 private:
  struct Entry {
    int block, row, column;  // place in the pattern; block row and column
  };
  struct Front {
    std::vector<int> pivot, rest;  // block rows eliminated here, and those coupled to them later
    std::vector<int> children;
    std::vector<Entry> entries;  // of the matrix, assembled here
    int pivots = 0, size = 0;    // numbers of rows that take part
    std::vector<int> rows;       // block rows that take part, pivots first
    std::vector<double> value;   // size by size, column-major: L and U, then the Schur complement
    std::vector<int> swaps;      // LAPACK's pivot rows
  };
  std::vector<Front> fronts_;  // children before parents
  std::vector<int> place_;     // per block row: its first row in the present front
  mutable std::vector<double> work_;

  void analyse(std::span<const int> start, std::span<const int> column);
  bool eliminate(Front& front);
};

}  // namespace voile
