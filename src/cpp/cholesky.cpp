#include "cholesky.hpp"

#include <cholmod.h>

#include <algorithm>
#include <stdexcept>
#include <string>

namespace voile {

struct Cholesky::Parts {
  cholmod_common common;
  cholmod_factor* factor = nullptr;
  cholmod_dense *x = nullptr, *work = nullptr, *more_work = nullptr;  // kept from solve to solve

  Parts() { cholmod_start(&common); }
  ~Parts() {
    for (cholmod_dense** dense : {&x, &work, &more_work}) cholmod_free_dense(dense, &common);
    cholmod_free_factor(&factor, &common);
    cholmod_finish(&common);
  }
};

Cholesky::Cholesky(int size, const int32_t* start, const int32_t* column, const double* value)
    : parts(std::make_unique<Parts>()) {
  cholmod_common& common = parts->common;
  common.print = 0;
  // The better of two orderings: the factor is made once and read many thousand times.
  common.nmethods = 2;
  common.method[0].ordering = CHOLMOD_AMD;
  common.method[1].ordering = CHOLMOD_METIS;
  // Solves with three right-hand sides read the factor once; supernodes only gain where blocks are large
  // (measured: 0.41 ms against 0.69 ms at 6,000 rows).
  common.supernodal = CHOLMOD_SIMPLICIAL;
  cholmod_sparse a{};
  a.nrow = a.ncol = size;
  a.nzmax = start[size];
  a.p = const_cast<int32_t*>(start);
  a.i = const_cast<int32_t*>(column);
  a.x = const_cast<double*>(value);
  a.stype = -1;  // reads one triangle
  a.itype = CHOLMOD_INT;
  a.xtype = CHOLMOD_REAL;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = a.packed = 1;
  parts->factor = cholmod_analyze(&a, &common);
  if (parts->factor) cholmod_factorize(&a, parts->factor, &common);
  if (!parts->factor || common.status < CHOLMOD_OK)
    throw std::runtime_error("CHOLMOD failed with status " + std::to_string(common.status));
  if (common.status == CHOLMOD_NOT_POSDEF || parts->factor->minor < (size_t)size)
    throw std::runtime_error("the matrix is not positive definite");
}

Cholesky::~Cholesky() = default;

int Cholesky::size() const { return (int)parts->factor->n; }
double Cholesky::nonzeros() const { return parts->common.lnz; }

void Cholesky::solve(double* b, int count) {
  cholmod_dense right{};
  right.nrow = right.d = parts->factor->n;
  right.ncol = count;
  right.nzmax = right.nrow * right.ncol;
  right.x = b;
  right.xtype = CHOLMOD_REAL;
  right.dtype = CHOLMOD_DOUBLE;
  if (!cholmod_solve2(CHOLMOD_A, parts->factor, &right, nullptr, &parts->x, nullptr, &parts->work,
                      &parts->more_work, &parts->common))
    throw std::runtime_error("CHOLMOD could not solve");
  const double* x = static_cast<const double*>(parts->x->x);
  std::copy(x, x + right.nzmax, b);
}

}  // namespace voile
