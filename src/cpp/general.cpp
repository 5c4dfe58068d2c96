#include "general.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "blas.hpp"

namespace voile {
namespace {

const int ONE = 1;
const double PLUS = 1.0, MINUS = -1.0;

}  // namespace

General::General(int size, const int32_t* start, const int32_t* column, int threads)
    : fronts(size, start, column, threads), l(fronts.panels() + fronts.across), pivots(size), turned(size) {
  int most = 0;
  for (const Front& f : fronts.all) most = std::max(most, f.below());
  work.resize(most);
}

bool General::factor(const double* value) {
  return fronts.run([&](const Front& f, double* sum) {
    std::memset(l.data() + f.panel, 0, sizeof(double) * f.width * f.height);
    std::memset(l.data() + fronts.panels() + f.across, 0, sizeof(double) * f.width * f.below());
    for (const auto& half : {f.lower, f.upper})
      for (const Entry& e : half) l[e.to] = value[e.from];
    std::memset(sum, 0, sizeof(double) * f.adds());
    for (int c = f.child; c >= 0; c = fronts.all[c].sibling) add(fronts.all[c], fronts.added(c), f, sum);
    return eliminate(f, sum);
  });
}

void General::add(const Front& child, const double* update, const Front& parent, double* sum) {
  const int rows = child.below(), below = parent.below(), width = parent.width;
  const int32_t *to = fronts.place.data() + child.into, *beyond = std::lower_bound(to, to + rows, width);
  const int own = (int)(beyond - to);
  double* across = l.data() + fronts.panels() + parent.across;
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
  double* across = l.data() + fronts.panels() + f.across;
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

void General::solve(const double* b, double* x) {
  const auto* order = static_cast<const int32_t*>(fronts.made->Perm);
  for (int i = 0; i < fronts.size(); ++i) turned[i] = b[order[i]];
  for (const Front& f : fronts.all) {
    const int below = f.below();
    const double* panel = l.data() + f.panel;
    double* own = turned.data() + f.first;
    for (int k = 0; k < f.width; ++k) std::swap(own[k], own[pivots[f.first + k] - 1]);
    dtrsv_("L", "N", "U", &f.width, panel, &f.height, own, &ONE);
    if (!below) continue;
    const double nothing = 0.0;
    dgemv_("N", &below, &f.width, &PLUS, panel + f.width, &f.height, own, &ONE, &nothing, work.data(), &ONE);
    for (int i = 0; i < below; ++i) turned[f.rows[f.width + i]] -= work[i];
  }
  for (auto f = fronts.all.rbegin(); f != fronts.all.rend(); ++f) {
    const int below = f->below();
    double* own = turned.data() + f->first;
    for (int i = 0; i < below; ++i) work[i] = turned[f->rows[f->width + i]];
    if (below)
      dgemv_("T", &below, &f->width, &MINUS, l.data() + fronts.panels() + f->across, &below, work.data(),
             &ONE, &PLUS, own, &ONE);
    dtrsv_("U", "N", "N", &f->width, l.data() + f->panel, &f->height, own, &ONE);
  }
  for (int i = 0; i < fronts.size(); ++i) x[order[i]] = turned[i];
}

}  // namespace voile
