#include "sweeps.hpp"

#include <algorithm>
#include <utility>

#include "blas.hpp"

namespace voile {
namespace {

const int ONE = 1;
const double PLUS = 1.0, MINUS = -1.0;

// x = op(a)^-1 x, op(a) n x n.
void divide(const char* kind, const char* op, const char* diagonal, int n, int sides, const double* a,
            int rows, double* x, int stride) {
  if (sides == 1)
    dtrsv_(kind, op, diagonal, &n, a, &rows, x, &ONE);
  else
    dtrsm_("L", kind, op, diagonal, &n, &sides, &PLUS, a, &rows, x, &stride);
}

// y -= op(a) x, a m x n.
void subtract(const char* op, int m, int n, int sides, const double* a, int rows, const double* x,
              int xstride, double* y, int ystride) {
  const int &to = *op == 'N' ? m : n, &from = *op == 'N' ? n : m;
  if (sides == 1)
    dgemv_(op, &m, &n, &MINUS, a, &rows, x, &ONE, &PLUS, y, &ONE);
  else
    dgemm_(op, "N", &to, &sides, &from, &MINUS, a, &rows, x, &xstride, &PLUS, y, &ystride);
}

}  // namespace

Sweeps::Sweeps(const Fronts& of) : fronts(of) {}

void Sweeps::take(const double* b, int many) {
  const int n = fronts.size();
  sides = many;
  x.resize((size_t)n * sides);
  beyond.resize(fronts.place.size() * sides);
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < sides; ++k) x[i + (size_t)k * n] = b[(size_t)fronts.order()[i] * sides + k];
}

void Sweeps::give(double* out) const {
  const int n = fronts.size();
  for (int i = 0; i < n; ++i)
    for (int k = 0; k < sides; ++k) out[(size_t)fronts.order()[i] * sides + k] = x[i + (size_t)k * n];
}

// What is beyond a front's square, and its stride.
std::pair<const double*, int> Sweeps::outside(const Triangle& by, const Front& f) const {
  return by.across ? std::pair(by.across + f.across, f.below())
                   : std::pair(by.panels + f.panel + f.width, f.height);
}

// Between the rows beyond a front's own and theirs in its parent.
template <class Move>
void Sweeps::each_rest(const Front& child, const Move& move) {
  const Front& parent = fronts.all[child.parent];
  const int32_t* place = fronts.place.data() + child.into;
  const int rows = child.below(), own = (int)(std::lower_bound(place, place + rows, parent.width) - place);
  for (int k = 0; k < sides; ++k) {
    double* here = rest(child) + (size_t)k * rows;
    double* there = x.data() + (size_t)k * fronts.size() + parent.first;
    double* further = rest(parent) + (size_t)k * parent.below() - parent.width;
    for (int i = 0; i < own; ++i) move(there[place[i]], here[i]);
    for (int i = own; i < rows; ++i) move(further[place[i]], here[i]);
  }
}

void Sweeps::forward(Team& team, const Triangle& by, const int* pivots) {
  const int n = fronts.size();
  fronts.upwards(team, [&](const Front& f) {
    const int below = f.below();
    double *own = x.data() + f.first, *rest = this->rest(f);
    std::fill(rest, rest + (size_t)below * sides, 0.0);
    for (int c = f.child; c >= 0; c = fronts.all[c].sibling)
      each_rest(fronts.all[c], [](double& there, double here) { there += here; });
    if (pivots) dlaswp_(&sides, own, &n, &ONE, &f.width, pivots + f.first, &ONE);
    divide(by.kind, *by.kind == 'L' ? "N" : "T", by.diagonal, f.width, sides, by.panels + f.panel, f.height,
           own, n);
    if (!below) return;
    const auto [a, rows] = outside(by, f);
    subtract("N", below, f.width, sides, a, rows, own, n, rest, below);
  });
}

void Sweeps::backward(Team& team, const Triangle& by, const int* pivots) {
  const int n = fronts.size(), back = -1;
  fronts.downwards(team, [&](const Front& f) {
    const int below = f.below();
    double* own = x.data() + f.first;
    if (below) {
      const auto [a, rows] = outside(by, f);
      each_rest(f, [](double there, double& here) { here = there; });
      subtract("T", below, f.width, sides, a, rows, rest(f), below, own, n);
    }
    divide(by.kind, *by.kind == 'L' ? "T" : "N", by.diagonal, f.width, sides, by.panels + f.panel, f.height,
           own, n);
    if (pivots) dlaswp_(&sides, own, &n, &ONE, &f.width, pivots + f.first, &back);
  });
}

}  // namespace voile
