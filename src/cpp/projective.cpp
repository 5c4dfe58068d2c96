#include "projective.hpp"

#include <algorithm>
#include <cmath>

namespace voile {

void LocalContacts::place(int c, const double* x, double p[3]) const {
  p[0] = p[1] = p[2] = 0.0;
  for (int s = MOST * c; s < MOST * (c + 1); ++s)
    for (int a = 0; a < 3; ++a) p[a] += weight[s] * x[3 * vertex[s] + a];
}

// r: the reaction that the laws project the trial reaction on.
void LocalContacts::project(int c, const double p[3], double rho, double r[3]) const {
  const double *n = &normal[3 * c], *at = &anchor[3 * c], *from = &start[3 * c], *old = &reaction[3 * c];
  double trial[3], pressed = 0.0, moved = 0.0, held = 0.0, opened = gap[c];
  for (int a = 0; a < 3; ++a) {
    opened += n[a] * (p[a] - at[a]);
    moved += n[a] * (p[a] - from[a]);
    held += n[a] * old[a];
  }
  pressed = held - rho * opened;
  if (pressed <= 0.0) {
    r[0] = r[1] = r[2] = 0.0;
    return;
  }
  double size = 0.0;
  for (int a = 0; a < 3; ++a) {
    trial[a] = old[a] - held * n[a] - rho * (p[a] - from[a] - moved * n[a]);
    size += trial[a] * trial[a];
  }
  size = std::sqrt(size);
  const double bound = friction[c] * pressed, share = size > bound ? bound / size : 1.0;
  for (int a = 0; a < 3; ++a) r[a] = pressed * n[a] + share * trial[a];
}

void Stiffness::relax(int u, const double* force, double* way) const {
  double rest = force[u];
  for (int k = start[u]; k < start[u + 1]; ++k) rest -= value[k] * way[column[k]];
  way[u] += rest / diagonal[u];
}

double LocalContacts::sweep(const double* x, const Stiffness& matrix, double* force, double* way) {
  double changed = 0.0;
  for (int c = 0; c < count(); ++c) {
    double p[3], r[3], soft = 0.0;  // m/N: motion by a reaction
    place(c, x, p);
    for (int s = MOST * c; s < MOST * (c + 1); ++s) {
      if (weight[s] == 0.0) continue;
      double firmest = 0.0;
      for (int a = 0; a < 3; ++a) {
        const int u = matrix.unknown[3 * vertex[s] + a];
        if (u < 0) continue;
        matrix.relax(u, force, way);
        p[a] += weight[s] * way[u];
        firmest = std::max(firmest, matrix.diagonal[u]);
      }
      if (firmest > 0.0) soft += weight[s] * weight[s] / firmest;
    }
    project(c, p, 1.0 / soft, r);
    for (int a = 0; a < 3; ++a) {
      const double change = r[a] - reaction[3 * c + a];
      if (change == 0.0) continue;
      reaction[3 * c + a] = r[a];
      changed += change * change;
      for (int s = MOST * c; s < MOST * (c + 1); ++s) {
        const int u = matrix.unknown[3 * vertex[s] + a];
        if (weight[s] == 0.0 || u < 0) continue;
        force[u] += weight[s] * change;
        way[u] += weight[s] * change / matrix.diagonal[u];
      }
    }
  }
  return changed;
}

void LocalContacts::spread(double* force) const {
  for (int s = 0; s < MOST * count(); ++s)
    for (int a = 0; a < 3; ++a) force[3 * vertex[s] + a] += weight[s] * reaction[3 * (s / MOST) + a];
}

double LocalContacts::mismatch(const double* x, const double* rho, const uint8_t* counts) const {
  double sum = 0.0;
  for (int c = 0; c < count(); ++c) {
    if (!counts[c]) continue;
    double p[3], r[3];
    place(c, x, p);
    project(c, p, rho[c], r);
    for (int a = 0; a < 3; ++a) sum += (r[a] - reaction[3 * c + a]) * (r[a] - reaction[3 * c + a]);
  }
  return sum;
}

}  // namespace voile
