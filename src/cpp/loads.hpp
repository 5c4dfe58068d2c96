// Tangent of loads that follow the surface.
#pragma once

#include "scatter.hpp"

namespace voile {

// Adds factors (m) times the symmetric part of d(N_t/6)/dx for every triangle, N_t = (x1 - x0) x (x2 - x0),
// each corner carrying N_t/6: block (j, k) = [e_k - e_j]x / 12. Exact where the load has a potential.
void add_pressure_hessian(Scatter& scatter, const int* corners, const double* positions, size_t triangles,
                          const double* factor);

}  // namespace voile
