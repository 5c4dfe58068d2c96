#include "loads.hpp"

namespace voile {

void add_pressure_hessian(Scatter& scatter, const int* corners, const double* positions, size_t triangles,
                          const double* factor) {
  double block[BLOCKS_LENGTH] = {};
  for (size_t t = 0; t < triangles; ++t) {
    const double* x[3];
    double e[3][3];
    for (int j = 0; j < 3; ++j) x[j] = positions + 3 * (size_t)corners[3 * t + j];
    for (int j = 0; j < 3; ++j)
      for (int d = 0; d < 3; ++d) e[j][d] = x[(j + 2) % 3][d] - x[(j + 1) % 3][d];
    for (int j = 0; j < 3; ++j)
      for (int k = j + 1; k < 3; ++k) {
        double w[3];
        for (int d = 0; d < 3; ++d) w[d] = factor[t] / 12.0 * (e[k][d] - e[j][d]);
        double* o = block + BLOCKS.start[j][k];
        o[1] = -w[2], o[2] = w[1], o[3] = w[2], o[5] = -w[0], o[6] = -w[1], o[7] = w[0];
      }
    scatter.add<1>((int)t, block, 0);
  }
}

}  // namespace voile
