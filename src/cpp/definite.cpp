#include "definite.hpp"

#include <cstring>

#include "blas.hpp"

namespace voile {

Definite::Definite(std::shared_ptr<Fronts> by)
    : fronts(std::move(by)), l(fronts->panels()), sweeps(*fronts) {}

bool Definite::factor(const double* value) {
  const double one = 1.0, minus = -1.0;
  return fronts->run([&](const Front& f, double* sum) {
    const int below = f.below();
    double *panel = l.data() + f.panel, *under = panel + f.width;
    std::memset(panel, 0, sizeof(double) * f.width * f.height);
    for (int k = 0; k < f.width; ++k)
      for (const Pair& e : fronts->pairs(f.first + k)) panel[(size_t)k * f.height + e.row] = value[e.lower];
    for (int j = 0; j < below; ++j) std::memset(sum + (size_t)j * below + j, 0, sizeof(double) * (below - j));
    for (int c = f.child; c >= 0; c = fronts->all[c].sibling)
      add(fronts->all[c], fronts->added(c), f, panel, sum);
    int info;
    dpotrf_("L", &f.width, panel, &f.height, &info);
    if (info) return false;
    if (below) {
      dtrsm_("R", "L", "T", "N", &below, &f.width, &one, panel, &f.height, under, &f.height);
      dsyrk_("L", "N", &below, &f.width, &minus, under, &f.height, &one, sum, &below);
    }
    return true;
  });
}

void Definite::add(const Front& child, const double* update, const Front& parent, double* panel,
                   double* sum) const {
  const int rows = child.below(), below = parent.below();
  const int32_t* to = fronts->place.data() + child.into;
  for (int j = 0; j < rows; ++j, update += rows) {
    const int left = to[j] - parent.width;
    double* column =
        left < 0 ? panel + (size_t)to[j] * parent.height : sum + (size_t)left * below - parent.width;
    for (int i = j; i < rows; ++i) column[to[i]] += update[i];
  }
}

void Definite::solve(const double* b, double* x, int sides, bool) {
  const Triangle lower{l.data(), nullptr, "L", "N"};
  sweeps.take(b, sides);
  sweeps.forward(lower);
  sweeps.backward(lower);
  sweeps.give(x);
}

}  // namespace voile
