// Sparse LU factors of matrices that change while their pattern, which is symmetric, stays: contacts that
// slip.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "sweeps.hpp"

namespace voile {

// L U of matrices of one pattern, with pivots sought among a front's own rows. At 1,400 to 3,200 unknowns in
// half of MUMPS' time.
class General {
 public:
  explicit General(std::shared_ptr<Fronts> fronts);

  // Factors the entries; false where a pivot is zero or not finite.
  bool factor(const double* value);
  // X = A^-1 B with the last factor, or A^-T B, by rows of `sides` numbers.
  void solve(const double* b, double* x, int sides = 1, bool transposed = false);
  const Fronts& by() const { return *fronts; }

 private:
  void add(const Front& child, const double* update, int from, int to, const Front& parent, double* sum);
  bool eliminate(const Front& f, double* sum, Team& team);

  std::shared_ptr<Fronts> fronts;
  std::vector<double> l;    // panels: L and, in their squares, U; after them U's rows beyond, transposed
  std::vector<int> pivots;  // LAPACK's, in their fronts
  Sweeps sweeps;
};

}  // namespace voile
