#include "definite.hpp"

#include <cstring>
#include <stdexcept>

#include "blas.hpp"

namespace voile {
namespace {

cholmod_dense dense(int size, const double* value) {
  cholmod_dense b{};
  b.nrow = b.nzmax = b.d = size;
  b.ncol = 1;
  b.x = const_cast<double*>(value);
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  return b;
}

}  // namespace

Definite::Definite(int size, const int32_t* start, const int32_t* column, int threads)
    : fronts(size, start, column, threads) {
  if (!cholmod_change_factor(CHOLMOD_REAL, true, true, true, true, fronts.made, &fronts.common))
    throw std::runtime_error("CHOLMOD has no memory for a factor");
}

Definite::~Definite() {
  for (cholmod_dense** each : {&result, &between, &beside}) cholmod_free_dense(each, &fronts.common);
}

bool Definite::factor(const double* value) {
  auto* l = static_cast<double*>(fronts.made->x);
  const double one = 1.0, minus = -1.0;
  const bool definite = fronts.run([&](const Front& f, double* sum) {
    const int below = f.below();
    double *panel = l + f.panel, *under = panel + f.width;
    std::memset(panel, 0, sizeof(double) * f.width * f.height);
    for (const Entry& e : f.lower) l[e.to] = value[e.from];
    for (int j = 0; j < below; ++j) std::memset(sum + (size_t)j * below + j, 0, sizeof(double) * (below - j));
    for (int c = f.child; c >= 0; c = fronts.all[c].sibling)
      add(fronts.all[c], fronts.added(c), f, panel, sum);
    int info;
    dpotrf_("L", &f.width, panel, &f.height, &info);
    if (info) return false;
    if (below) {
      dtrsm_("R", "L", "T", "N", &below, &f.width, &one, panel, &f.height, under, &f.height);
      dsyrk_("L", "N", &below, &f.width, &minus, under, &f.height, &one, sum, &below);
    }
    return true;
  });
  fronts.made->minor = fronts.made->n;
  return definite;
}

void Definite::add(const Front& child, const double* update, const Front& parent, double* panel,
                   double* sum) const {
  const int rows = child.below(), below = parent.below();
  const int32_t* to = fronts.place.data() + child.into;
  for (int j = 0; j < rows; ++j, update += rows) {
    const int left = to[j] - parent.width;
    double* column =
        left < 0 ? panel + (size_t)to[j] * parent.height : sum + (size_t)left * below - parent.width;
    for (int i = j; i < rows; ++i) column[to[i]] += update[i];
  }
}

void Definite::solve(const double* b, double* x) {
  cholmod_dense right = dense(fronts.size(), b);
  if (!cholmod_solve2(CHOLMOD_A, fronts.made, &right, nullptr, &result, nullptr, &between, &beside,
                      &fronts.common))
    throw std::runtime_error("CHOLMOD did not solve");
  std::memcpy(x, result->x, sizeof(double) * fronts.size());
}

}  // namespace voile
