#include "projective.hpp"

#include <cmath>

namespace voile {
namespace {

VOILE_INLINED double dot(const Double4& a, const Double4& b) {
  const Double4 c = a * b;
  return c[0] + c[1] + c[2];
}

VOILE_INLINED Double4 point(const double* x) { return Double4{x[0], x[1], x[2], 0.0}; }

}  // namespace

VOILE_INLINED Double4 LocalContact::place(const double* x) const {
  Double4 p = {};
  for (int s = 0; s < MOST; ++s)
    if (weight[s] != 0.0) p += weight[s] * point(x + 3 * (size_t)vertex[s]);
  return p;
}

VOILE_INLINED Double4 LocalContact::projected(const Double4& p, double rho) const {
  const Double4 slip = p - start;
  const double held = dot(normal, reaction), opened = gap + dot(normal, p - anchor);
  const double pressed = held - rho * opened;
  if (pressed <= 0.0) return Double4{};
  const Double4 trial = reaction - held * normal - rho * (slip - dot(normal, slip) * normal);
  const double size = std::sqrt(dot(trial, trial)), bound = friction * pressed;
  return pressed * normal + (size > bound ? bound / size : 1.0) * trial;
}

VOILE_INLINED void Stiffness::relax(int u, const Double4* force, Double4* way) const {
  Double4 rest = force[u];
  for (int k = start[u]; k < start[u + 1]; ++k) rest -= value[k] * way[column[k]];
  way[u] += rest * fours(soft.data())[u];
}

// Sum of squares of the changes of a pass.
VOILE_CLONES static double pass(std::vector<LocalContact>& contacts, const double* x, const Stiffness& matrix,
                                Double4* force, Double4* way) {
  const Double4 *free = fours(matrix.free.data()), *soft = fours(matrix.soft.data());
  double changed = 0.0;
  for (LocalContact& c : contacts) {
    Double4 p = c.place(x);
    double yields = 0.0;  // m/N: motion by a reaction
    for (int s = 0; s < LocalContact::MOST; ++s) {
      const int v = c.vertex[s], u = c.weight[s] == 0.0 ? -1 : matrix.node[v];
      if (u < 0) continue;
      matrix.relax(u, force, way);
      p += c.weight[s] * free[v] * way[u];
      yields += c.weight[s] * c.weight[s] / matrix.diagonal[u];
    }
    const Double4 now = c.projected(p, 1.0 / yields), change = now - c.reaction;
    c.reaction = now;
    changed += dot(change, change);
    for (int s = 0; s < LocalContact::MOST; ++s) {
      const int v = c.vertex[s], u = c.weight[s] == 0.0 ? -1 : matrix.node[v];
      if (u < 0) continue;
      const Double4 push = c.weight[s] * free[v] * change;
      force[u] += push;
      way[u] += push * soft[u];
    }
  }
  return changed;
}

void LocalContacts::sweep(const double* x, const Stiffness& matrix, const double* force, int passes,
                          double settled) {
  pushed.assign(matrix.soft.size(), 0.0);
  way.assign(matrix.soft.size(), 0.0);
  for (size_t u = 0; u < matrix.slot.size(); ++u) pushed[matrix.slot[u]] = force[u];
  const double first = pass(all, x, matrix, fours(pushed.data()), fours(way.data()));
  for (int k = 1; k < passes; ++k)
    if (pass(all, x, matrix, fours(pushed.data()), fours(way.data())) <= settled * settled * first) break;
}

void LocalContacts::spread(double* force) const {
  for (const LocalContact& c : all)
    for (int s = 0; s < LocalContact::MOST; ++s)
      for (int a = 0; a < 3; ++a) force[3 * c.vertex[s] + a] += c.weight[s] * c.reaction[a];
}

VOILE_CLONES static double missed(const std::vector<LocalContact>& contacts, const double* x,
                                  const double* rho, const uint8_t* counts) {
  double sum = 0.0;
  for (size_t k = 0; k < contacts.size(); ++k) {
    if (!counts[k]) continue;
    const LocalContact& c = contacts[k];
    const Double4 off = c.projected(c.place(x), rho[k]) - c.reaction;
    sum += dot(off, off);
  }
  return sum;
}

double LocalContacts::mismatch(const double* x, const double* rho, const uint8_t* counts) const {
  return missed(all, x, rho, counts);
}

}  // namespace voile
