// Sparse Cholesky factorisation by CHOLMOD (Davis et al., SuiteSparse), kept for many solves with few
// right-hand sides.
#pragma once

#include <cstdint>
#include <memory>

namespace voile {

class Cholesky {
 public:
  // Rows of a symmetric positive definite matrix, both triangles, columns ascending. Throws
  // std::runtime_error where it is not positive definite.
  Cholesky(int size, const int32_t* start, const int32_t* column, const double* value);
  ~Cholesky();
  Cholesky(const Cholesky&) = delete;
  Cholesky& operator=(const Cholesky&) = delete;

  // b = A^-1 b for `count` right-hand sides, one after the other.
  void solve(double* b, int count);
  int size() const;
  double nonzeros() const;  // of the factor

 private:
  struct Parts;
  std::unique_ptr<Parts> parts;
};

}  // namespace voile
