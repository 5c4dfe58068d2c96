// Sparse LU factors of matrices that change while their pattern, which is symmetric, stays: contacts that
// slip.
#pragma once

#include "fronts.hpp"

namespace voile {

// L U of matrices of one pattern, with pivots sought among a front's own rows. At 1,400 to 3,200 unknowns in
// half of MUMPS' time.
class General {
 public:
  // See Fronts.
  General(int size, const int32_t* start, const int32_t* column, int threads = 1);

  // Factors the entries; false where a pivot is zero or not finite.
  bool factor(const double* value);
  // x = A^-1 b with the last factor.
  void solve(const double* b, double* x);
  const Fronts& by() const { return fronts; }

 private:
  void add(const Front& child, const double* update, const Front& parent, double* sum);
  bool eliminate(const Front& f, double* sum);

  Fronts fronts;
  std::vector<double> l;    // panels: L and, in their squares, U; after them U's rows beyond, transposed
  std::vector<int> pivots;  // LAPACK's, in their fronts
  std::vector<double> work, turned;
};

}  // namespace voile
