#include "definite.hpp"

#include <algorithm>
#include <cstring>

#include "blas.hpp"

namespace voile {
namespace {

const double PLUS = 1.0, MINUS = -1.0;

// C -= A B^T on and below C's diagonal: A (rows x inner) is of B's stride, which holds A's first rows.
void subtract(int rows, int columns, int inner, const double* a, int lda, double* c, int ldc, int piece,
              Team& team) {
  team.split(columns, piece, [&](int from, int to) {
    const int wide = to - from, under = rows - to;
    double* square = c + (size_t)from * ldc + from;
    dsyrk_("L", "N", &wide, &inner, &MINUS, a + from, &lda, &PLUS, square, &ldc);
    if (under)
      dgemm_("N", "T", &under, &wide, &inner, &MINUS, a + to, &lda, a + from, &lda, &PLUS, square + wide,
             &ldc);
  });
}

bool eliminate(const Front& f, double* panel, double* sum, Team& team) {
  const int below = f.below();
  for (int from = 0, to; from < f.width; from = to) {
    to = std::min(f.width, from + f.piece());
    const int wide = to - from, under = f.height - to;
    double *square = panel + (size_t)from * (f.height + 1), *rest = square + wide;
    int info;
    dpotrf_("L", &wide, square, &f.height, &info);
    if (info) return false;
    team.split(under, f.piece(), [&](int first, int last) {
      const int rows = last - first;
      dtrsm_("R", "L", "T", "N", &rows, &wide, &PLUS, square, &f.height, rest + first, &f.height);
    });
    subtract(under, f.width - to, wide, rest, f.height, rest + (size_t)wide * f.height, f.height, f.piece(),
             team);
  }
  subtract(below, below, f.width, panel + f.width, f.height, sum, below, f.piece(), team);
  return true;
}

}  // namespace

Definite::Definite(std::shared_ptr<Fronts> by)
    : fronts(std::move(by)), l(fronts->panels()), sweeps(*fronts) {}

bool Definite::factor(const double* value) {
  return fronts->run([&](const Front& f, double* sum, Team& team) {
    const int below = f.below();
    double* panel = l.data() + f.panel;
    team.split(f.height, f.piece(), [&](int from, int to) {
      for (int j = from; j < to; ++j)
        std::memset(
            j < f.width ? panel + (size_t)j * (f.height + 1) : sum + (size_t)(j - f.width) * (below + 1), 0,
            sizeof(double) * (f.height - j));
    });
    for (int k = 0; k < f.width; ++k)
      for (const Pair& e : fronts->pairs(f.first + k)) panel[(size_t)k * f.height + e.row] = value[e.lower];
    for (int c = f.child; c >= 0; c = fronts->all[c].sibling)
      team.split(fronts->all[c].below(), f.piece(),
                 [&](int from, int to) { add(fronts->all[c], fronts->added(c), from, to, f, panel, sum); });
    return eliminate(f, panel, sum, team);
  });
}

// Columns of what a child adds.
void Definite::add(const Front& child, const double* update, int from, int to, const Front& parent,
                   double* panel, double* sum) const {
  const int rows = child.below(), below = parent.below();
  const int32_t* place = fronts->place.data() + child.into;
  update += (size_t)from * rows;
  for (int j = from; j < to; ++j, update += rows) {
    const int left = place[j] - parent.width;
    double* column =
        left < 0 ? panel + (size_t)place[j] * parent.height : sum + (size_t)left * below - parent.width;
    for (int i = j; i < rows; ++i) column[place[i]] += update[i];
  }
}

void Definite::solve(const double* b, double* x, int sides, bool) {
  const Triangle lower{l.data(), nullptr, "L", "N"};
  Team team(fronts->sweepers());
  sweeps.take(b, sides);
  sweeps.forward(team, lower);
  sweeps.backward(team, lower);
  sweeps.give(x);
}

}  // namespace voile
