#include "definite.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

extern "C" {
void dpotrf_(const char* uplo, const int* n, double* a, const int* lda, int* info);
void dtrsm_(const char* side, const char* uplo, const char* trans, const char* diagonal, const int* m,
            const int* n, const double* alpha, const double* a, const int* lda, double* b, const int* ldb);
void dsyrk_(const char* uplo, const char* trans, const int* n, const int* k, const double* alpha,
            const double* a, const int* lda, const double* beta, double* c, const int* ldc);
}

namespace voile {
namespace {

[[noreturn]] void fail(int status) {
  throw std::runtime_error("CHOLMOD failed with status " + std::to_string(status));
}

cholmod_dense dense(int size, const double* value) {
  cholmod_dense b{};
  b.nrow = b.nzmax = b.d = size;
  b.ncol = 1;
  b.x = const_cast<double*>(value);
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  return b;
}

cholmod_sparse symmetric(int size, const int32_t* start, const int32_t* column, const double* value) {
  cholmod_sparse a{};
  a.nrow = a.ncol = size;
  a.nzmax = start[size];
  a.p = const_cast<int32_t*>(start);
  a.i = const_cast<int32_t*>(column);
  a.x = const_cast<double*>(value);
  a.stype = 1;  // one triangle is read
  a.itype = CHOLMOD_INT;
  a.xtype = CHOLMOD_REAL;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = a.packed = 1;
  return a;
}

}  // namespace

Definite::Definite(int size, const int32_t* start, const int32_t* column) : given(start[size]) {
  cholmod_start(&common);
  common.print = 0;
  common.nmethods = 2;  // the ordering of lower cost
  common.method[0].ordering = CHOLMOD_AMD;
  common.method[1].ordering = CHOLMOD_METIS;
  common.supernodal = CHOLMOD_SUPERNODAL;
  std::vector<double> number(given);
  std::iota(number.begin(), number.end(), 0.0);
  cholmod_sparse a = symmetric(size, start, column, number.data());
  made = cholmod_analyze(&a, &common);
  if (!made || !cholmod_change_factor(CHOLMOD_REAL, true, true, true, true, made, &common))
    fail(common.status);

  const auto *super = static_cast<const int32_t*>(made->super), *at = static_cast<const int32_t*>(made->pi);
  const auto *panel = static_cast<const int32_t*>(made->px), *row = static_cast<const int32_t*>(made->s);
  const int count = (int)made->nsuper;
  std::vector<int32_t> front(size);  // of each column
  for (int k = 0; k < count; ++k) {
    fronts.push_back({super[k + 1] - super[k], at[k + 1] - at[k], (size_t)panel[k], 0, -1, -1});
    std::fill(&front[super[k]], &front[super[k]] + fronts[k].width, k);
  }
  size_t now = 0, most = 0;
  for (int k = 0; k < count; ++k) {
    const size_t below = fronts[k].height - fronts[k].width;
    most = std::max(most, now += below * below);
    for (int c = fronts[k].child; c >= 0; c = fronts[c].sibling) {
      const size_t theirs = fronts[c].height - fronts[c].width;
      now -= theirs * theirs;
    }
    if (!below) continue;
    const int32_t *own = row + at[k] + fronts[k].width, *end = row + at[k + 1];
    const int parent = front[*own];
    fronts[k].into = place.size();
    for (const int32_t *r = own, *p = row + at[parent]; r < end; ++r) {
      while (*p < *r) ++p;
      place.push_back((int32_t)(p - (row + at[parent])));
    }
    fronts[k].sibling = std::exchange(fronts[parent].child, k);
  }
  updates.resize(most);

  auto* turned = cholmod_ptranspose(&a, 2, static_cast<int32_t*>(made->Perm), nullptr, 0, &common);
  if (!turned) fail(common.status);
  const auto *begin = static_cast<const int32_t*>(turned->p), *i = static_cast<const int32_t*>(turned->i);
  const auto* which = static_cast<const double*>(turned->x);
  for (int j = 0; j < size; ++j) {
    const int k = front[j];
    const int32_t *first = row + at[k], *end = row + at[k + 1];
    const size_t top = fronts[k].panel + (size_t)(j - super[k]) * fronts[k].height;
    for (int e = begin[j]; e < begin[j + 1]; ++e)
      lower.push_back({(int32_t)which[e], top + (std::lower_bound(first, end, i[e]) - first)});
  }
  cholmod_free_sparse(&turned, &common);
}

Definite::~Definite() {
  for (cholmod_dense** each : {&result, &between, &beside}) cholmod_free_dense(each, &common);
  cholmod_free_factor(&made, &common);
  cholmod_finish(&common);
}

bool Definite::factor(const double* value) {
  auto* l = static_cast<double*>(made->x);
  std::memset(l, 0, sizeof(double) * made->xsize);
  for (const Entry& e : lower) l[e.to] = value[e.from];
  const double one = 1.0, minus = -1.0;
  double* top = updates.data();
  for (const Front& f : fronts) {
    const int below = f.height - f.width;
    double *panel = l + f.panel, *under = panel + f.width, *sum = top;
    for (int j = 0; j < below; ++j) std::memset(sum + (size_t)j * below + j, 0, sizeof(double) * (below - j));
    for (int c = f.child; c >= 0; c = fronts[c].sibling) {
      const size_t theirs = fronts[c].height - fronts[c].width;
      add(fronts[c], top -= theirs * theirs, f, panel, sum);
    }
    int info;
    dpotrf_("L", &f.width, panel, &f.height, &info);
    if (info) return false;
    if (below) {
      dtrsm_("R", "L", "T", "N", &below, &f.width, &one, panel, &f.height, under, &f.height);
      dsyrk_("L", "N", &below, &f.width, &minus, under, &f.height, &one, sum, &below);
    }
    std::memmove(top, sum, sizeof(double) * below * below);
    top += (size_t)below * below;
  }
  made->minor = made->n;
  return true;
}

void Definite::add(const Front& child, const double* update, const Front& parent, double* panel,
                   double* sum) const {
  const int rows = child.height - child.width, below = parent.height - parent.width;
  const int32_t* to = place.data() + child.into;
  for (int j = 0; j < rows; ++j, update += rows) {
    const int left = to[j] - parent.width;
    double* column =
        left < 0 ? panel + (size_t)to[j] * parent.height : sum + (size_t)left * below - parent.width;
    for (int i = j; i < rows; ++i) column[to[i]] += update[i];
  }
}

void Definite::solve(const double* b, double* x) {
  cholmod_dense right = dense(size(), b);
  if (!cholmod_solve2(CHOLMOD_A, made, &right, nullptr, &result, nullptr, &between, &beside, &common))
    fail(common.status);
  std::memcpy(x, result->x, sizeof(double) * size());
}

}  // namespace voile
