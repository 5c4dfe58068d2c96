// Solves with triangular factors by fronts, many right-hand sides at once.
#pragma once

#include <utility>
#include <vector>

#include "fronts.hpp"

namespace voile {

// L, or U transposed: by fronts squares of `panels`, and what is beyond them there, or in `across`.
struct Triangle {
  const double *panels, *across;
  const char *kind, *diagonal;  // BLAS': "L" or "U", "U" for a diagonal of ones or "N"
};

class Sweeps {
 public:
  explicit Sweeps(const Fronts& fronts);

  // Takes right-hand sides b (size, sides), by rows.
  void take(const double* b, int sides);
  // Solves with L, whose rows pivots swap within their fronts, or with U^T.
  void forward(Team& team, const Triangle& by, const int* pivots = nullptr);
  // With L^T or U.
  void backward(Team& team, const Triangle& by, const int* pivots = nullptr);
  // x as b.
  void give(double* x) const;

 private:
  std::pair<const double*, int> outside(const Triangle& by, const Front& f) const;
  double* rest(const Front& f) { return beyond.data() + f.into * sides; }
  template <class Move>
  void each_rest(const Front& child, const Move& move);

  const Fronts& fronts;
  int sides = 0;
  std::vector<double> x, beyond;  // by columns: in the order; of each front the rows beyond its own
};

}  // namespace voile
