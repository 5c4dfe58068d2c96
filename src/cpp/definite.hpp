// Sparse Cholesky factors of matrices that change while their pattern stays: Newton's method downhill.
#pragma once

#include <cholmod.h>

#include <cstdint>
#include <vector>

namespace voile {

// CHOLMOD's settings, without messages, and one factor. It runs its loops on four threads whatever OpenMP is
// told; these only wait for each other at our sizes (2.7 times the time at 3,000 unknowns), so it gets one.
class Workshop {
 public:
  cholmod_common common;
  cholmod_factor* factor = nullptr;
  Workshop();
  ~Workshop();
  Workshop(const Workshop&) = delete;
  Workshop& operator=(const Workshop&) = delete;

  // The lower-cost of AMD's and METIS' orderings; supernodes. Throws std::runtime_error.
  void analyse(cholmod_sparse& matrix);
  // Whether the matrix is positive definite. Throws std::runtime_error where anything else fails.
  bool factorise(cholmod_sparse& matrix);
};

// A symmetric matrix by rows, both triangles, columns ascending, as CHOLMOD reads it.
cholmod_sparse symmetric(int size, const int32_t* start, const int32_t* column, const double* value);

// L L^T of symmetric matrices of one pattern by CHOLMOD (Davis et al., SuiteSparse).
class Definite {
 public:
  // The pattern, which is copied. Throws std::runtime_error.
  Definite(int size, const int32_t* start, const int32_t* column);
  ~Definite();

  // Factors the entries; false where they are not positive definite, found at the first pivot that is not.
  bool factor(const double* value);
  // x = A^-1 b with the last factor.
  void solve(const double* b, double* x);
  int size() const { return (int)start.size() - 1; }
  int entries() const { return (int)column.size(); }

 private:
  Workshop shop;
  std::vector<int32_t> start, column;
  cholmod_dense *result = nullptr, *between = nullptr, *beside = nullptr;  // kept from solve to solve
};

}  // namespace voile
