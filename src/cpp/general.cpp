#include "general.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "blas.hpp"

namespace voile {
namespace {

const double PLUS = 1.0, MINUS = -1.0;

}  // namespace

General::General(std::shared_ptr<Fronts> by)
    : fronts(std::move(by)), l(fronts->panels() + fronts->across), pivots(fronts->size()), sweeps(*fronts) {}

bool General::factor(const double* value) {
  return fronts->run([&](const Front& f, double* sum) {
    double *panel = l.data() + f.panel, *across = l.data() + fronts->panels() + f.across;
    std::memset(panel, 0, sizeof(double) * f.width * f.height);
    std::memset(across, 0, sizeof(double) * f.width * f.below());
    for (int k = 0; k < f.width; ++k)
      for (const Pair& e : fronts->pairs(f.first + k)) {
        panel[(size_t)k * f.height + e.row] = value[e.lower];
        (e.row < f.width ? panel[(size_t)e.row * f.height + k]
                         : across[(size_t)k * f.below() + e.row - f.width]) = value[e.upper];
      }
    std::memset(sum, 0, sizeof(double) * f.adds());
    for (int c = f.child; c >= 0; c = fronts->all[c].sibling) add(fronts->all[c], fronts->added(c), f, sum);
    return eliminate(f, sum);
  });
}

void General::add(const Front& child, const double* update, const Front& parent, double* sum) {
  const int rows = child.below(), below = parent.below(), width = parent.width;
  const int32_t *to = fronts->place.data() + child.into, *beyond = std::lower_bound(to, to + rows, width);
  const int own = (int)(beyond - to);
  double* across = l.data() + fronts->panels() + parent.across;
  for (int j = 0; j < rows; ++j, update += rows) {
    if (j < own) {
      double* column = l.data() + parent.panel + (size_t)to[j] * parent.height;
      for (int i = 0; i < rows; ++i) column[to[i]] += update[i];
      continue;
    }
    double *row = across + to[j] - width, *column = sum + (size_t)(to[j] - width) * below - width;
    for (int i = 0; i < own; ++i) row[(size_t)to[i] * below] += update[i];
    for (int i = own; i < rows; ++i) column[to[i]] += update[i];
  }
}

bool General::eliminate(const Front& f, double* sum) {
  double *panel = l.data() + f.panel, *under = panel + f.width;
  double* across = l.data() + fronts->panels() + f.across;
  int *pivot = pivots.data() + f.first, info;
  const int below = f.below();
  dgetrf_(&f.width, &f.width, panel, &f.height, pivot, &info);
  if (info || !std::isfinite(panel[(size_t)(f.width - 1) * (f.height + 1)])) return false;
  if (!below) return true;
  for (int k = 0; k < f.width; ++k)
    if (pivot[k] != k + 1) {
      double* one = across + (size_t)k * below;
      std::swap_ranges(one, one + below, across + (size_t)(pivot[k] - 1) * below);
    }
  dtrsm_("R", "L", "T", "U", &below, &f.width, &PLUS, panel, &f.height, across, &below);
  dtrsm_("R", "U", "N", "N", &below, &f.width, &PLUS, panel, &f.height, under, &f.height);
  dgemm_("N", "T", &below, &below, &f.width, &MINUS, under, &f.height, across, &below, &PLUS, sum, &below);
  return true;
}

void General::solve(const double* b, double* x, int sides, bool transposed) {
  const Triangle lower{l.data(), nullptr, "L", "U"}, upper{l.data(), l.data() + fronts->panels(), "U", "N"};
  sweeps.take(b, sides);
  if (transposed) {
    sweeps.forward(upper);
    sweeps.backward(lower, pivots.data());
  } else {
    sweeps.forward(lower, pivots.data());
    sweeps.backward(upper);
  }
  sweeps.give(x);
}

}  // namespace voile
