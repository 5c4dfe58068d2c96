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
  return fronts->run([&](const Front& f, double* sum, Team& team) {
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
    for (int c = f.child; c >= 0; c = fronts->all[c].sibling)
      team.split(fronts->all[c].below(), f.piece(),
                 [&](int from, int to) { add(fronts->all[c], fronts->added(c), from, to, f, sum); });
    return eliminate(f, sum, team);
  });
}

// Columns of what a child adds.
void General::add(const Front& child, const double* update, int from, int to, const Front& parent,
                  double* sum) {
  const int rows = child.below(), below = parent.below(), width = parent.width;
  const int32_t* place = fronts->place.data() + child.into;
  const int own = (int)(std::lower_bound(place, place + rows, width) - place);
  double* across = l.data() + fronts->panels() + parent.across;
  update += (size_t)from * rows;
  for (int j = from; j < to; ++j, update += rows) {
    if (j < own) {
      double* column = l.data() + parent.panel + (size_t)place[j] * parent.height;
      for (int i = 0; i < rows; ++i) column[place[i]] += update[i];
      continue;
    }
    double *row = across + place[j] - width, *column = sum + (size_t)(place[j] - width) * below - width;
    for (int i = 0; i < own; ++i) row[(size_t)place[i] * below] += update[i];
    for (int i = own; i < rows; ++i) column[place[i]] += update[i];
  }
}

bool General::eliminate(const Front& f, double* sum, Team& team) {
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
  team.split(below, f.piece(), [&](int from, int to) {
    const int rows = to - from;
    dtrsm_("R", "L", "T", "U", &rows, &f.width, &PLUS, panel, &f.height, across + from, &below);
    dtrsm_("R", "U", "N", "N", &rows, &f.width, &PLUS, panel, &f.height, under + from, &f.height);
  });
  team.split(below, f.piece(), [&](int from, int to) {
    const int columns = to - from;
    dgemm_("N", "T", &below, &columns, &f.width, &MINUS, under, &f.height, across + from, &below, &PLUS,
           sum + (size_t)from * below, &below);
  });
  return true;
}

void General::solve(const double* b, double* x, int sides, bool transposed) {
  const Triangle lower{l.data(), nullptr, "L", "U"}, upper{l.data(), l.data() + fronts->panels(), "U", "N"};
  Team team(fronts->sweepers());
  sweeps.take(b, sides);
  if (transposed) {
    sweeps.forward(team, upper);
    sweeps.backward(team, lower, pivots.data());
  } else {
    sweeps.forward(team, lower, pivots.data());
    sweeps.backward(team, upper);
  }
  sweeps.give(x);
}

}  // namespace voile
