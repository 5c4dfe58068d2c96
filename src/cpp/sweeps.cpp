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

Sweeps::Sweeps(const Fronts& of) : fronts(of) {
  for (const Front& f : of.all) most = std::max(most, f.below());
}

void Sweeps::take(const double* b, int many) {
  const int n = fronts.size();
  sides = many;
  x.resize((size_t)n * sides);
  beyond.resize((size_t)most * sides);
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

// Between x's rows beyond a front's own and `beyond`.
template <class Move>
void Sweeps::each_beyond(const Front& f, const Move& move) {
  for (int k = 0; k < sides; ++k) {
    double *there = x.data() + (size_t)k * fronts.size(), *here = beyond.data() + (size_t)k * f.below();
    for (int i = f.width; i < f.height; ++i) move(there[f.rows[i]], *here++);
  }
}

void Sweeps::forward(const Triangle& by, const int* pivots) {
  const int n = fronts.size();
  for (const Front& f : fronts.all) {
    const int below = f.below();
    double* own = x.data() + f.first;
    if (pivots) dlaswp_(&sides, own, &n, &ONE, &f.width, pivots + f.first, &ONE);
    divide(by.kind, *by.kind == 'L' ? "N" : "T", by.diagonal, f.width, sides, by.panels + f.panel, f.height,
           own, n);
    if (!below) continue;
    const auto [a, rows] = outside(by, f);
    each_beyond(f, [](double there, double& here) { here = there; });
    subtract("N", below, f.width, sides, a, rows, own, n, beyond.data(), below);
    each_beyond(f, [](double& there, double here) { there = here; });
  }
}

void Sweeps::backward(const Triangle& by, const int* pivots) {
  const int n = fronts.size(), back = -1;
  for (auto f = fronts.all.rbegin(); f != fronts.all.rend(); ++f) {
    const int below = f->below();
    double* own = x.data() + f->first;
    if (below) {
      const auto [a, rows] = outside(by, *f);
      each_beyond(*f, [](double there, double& here) { here = there; });
      subtract("T", below, f->width, sides, a, rows, beyond.data(), below, own, n);
    }
    divide(by.kind, *by.kind == 'L' ? "T" : "N", by.diagonal, f->width, sides, by.panels + f->panel,
           f->height, own, n);
    if (pivots) dlaswp_(&sides, own, &n, &ONE, &f->width, pivots + f->first, &back);
  }
}

}  // namespace voile
