#include "definite.hpp"

#include <omp.h>

#include <cstring>
#include <stdexcept>
#include <string>

namespace voile {
namespace {

// No region of OpenMP runs on several threads while it lives.
struct OneThread {
  int levels = omp_get_max_active_levels();
  OneThread() { omp_set_max_active_levels(0); }
  ~OneThread() { omp_set_max_active_levels(levels); }
};

cholmod_dense dense(int size, const double* value) {
  cholmod_dense b{};
  b.nrow = b.nzmax = b.d = size;
  b.ncol = 1;
  b.x = const_cast<double*>(value);
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  return b;
}

[[noreturn]] void fail(int status) {
  throw std::runtime_error("CHOLMOD failed with status " + std::to_string(status));
}

}  // namespace

Workshop::Workshop() {
  cholmod_start(&common);
  common.print = 0;
  common.nmethods = 2;
  common.method[0].ordering = CHOLMOD_AMD;
  common.method[1].ordering = CHOLMOD_METIS;
  common.supernodal = CHOLMOD_SUPERNODAL;
}

Workshop::~Workshop() {
  cholmod_free_factor(&factor, &common);
  cholmod_finish(&common);
}

void Workshop::analyse(cholmod_sparse& matrix) {
  const OneThread guard;
  factor = cholmod_analyze(&matrix, &common);
  if (!factor) fail(common.status);
}

bool Workshop::factorise(cholmod_sparse& matrix) {
  const OneThread guard;
  cholmod_factorize(&matrix, factor, &common);
  if (common.status < CHOLMOD_OK) fail(common.status);
  return common.status != CHOLMOD_NOT_POSDEF && factor->minor == factor->n;
}

cholmod_sparse symmetric(int size, const int32_t* start, const int32_t* column, const double* value) {
  cholmod_sparse a{};
  a.nrow = a.ncol = size;
  a.nzmax = start[size];
  a.p = const_cast<int32_t*>(start);
  a.i = const_cast<int32_t*>(column);
  a.x = const_cast<double*>(value);
  a.stype = 1;  // reads one triangle, and turns it once where the other one would be turned twice
  a.itype = CHOLMOD_INT;
  a.xtype = value ? CHOLMOD_REAL : CHOLMOD_PATTERN;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = a.packed = 1;
  return a;
}

Definite::Definite(int size, const int32_t* start_, const int32_t* column_)
    : start(start_, start_ + size + 1), column(column_, column_ + start_[size]) {
  cholmod_sparse a = symmetric(size, start.data(), column.data(), nullptr);
  shop.analyse(a);
}

Definite::~Definite() {
  for (cholmod_dense** each : {&result, &between, &beside}) cholmod_free_dense(each, &shop.common);
}

bool Definite::factor(const double* value) {
  cholmod_sparse a = symmetric(size(), start.data(), column.data(), value);
  return shop.factorise(a);
}

void Definite::solve(const double* b, double* x) {
  cholmod_dense right = dense(size(), b);
  if (!cholmod_solve2(CHOLMOD_A, shop.factor, &right, nullptr, &result, nullptr, &between, &beside,
                      &shop.common))
    fail(shop.common.status);
  std::memcpy(x, result->x, sizeof(double) * size());
}

}  // namespace voile
