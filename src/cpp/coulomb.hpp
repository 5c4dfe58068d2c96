// Signorini's and Coulomb's laws of one contact as equations, in the frame (normal, tangent 1, tangent 2).
#pragma once

#include <array>
#include <cmath>

namespace voile {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<double, 9>;  // row-major

enum class ContactState : char { open = 0, stick = 1, slip = 2 };

// F(r, u) = 0 and its generalised derivative dF = A dr + B du.
struct NaturalMap {
  ContactState state;
  Vec3 F;
  Mat3 A, B;
};

// Alart & Curnier 1991: with the trial reaction z = r - rho u, F = r - (max(0, z_N), P z_T), P the projection
// on the disc of radius mu max(0, z_N). Times rho in the normal direction and where the contact sticks.
inline NaturalMap natural_map(const double* r, const double* u, double mu, double rho) {
  const double zn = r[0] - rho * u[0], z1 = r[1] - rho * u[1], z2 = r[2] - rho * u[2];
  if (zn <= 0.0) return {ContactState::open, {r[0], r[1], r[2]}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {}};
  const double size = std::sqrt(z1 * z1 + z2 * z2), bound = mu * zn;
  if (size <= bound)
    return {ContactState::stick, {rho * u[0], rho * u[1], rho * u[2]}, {}, {rho, 0, 0, 0, rho, 0, 0, 0, rho}};
  const double t1 = z1 / size, t2 = z2 / size, share = bound / size;
  const double p11 = share * t2 * t2, p12 = -share * t1 * t2, p22 = share * t1 * t1;
  return {ContactState::slip,
          {rho * u[0], r[1] - bound * t1, r[2] - bound * t2},
          {0, 0, 0, -mu * t1, 1 - p11, -p12, -mu * t2, -p12, 1 - p22},
          {rho, 0, 0, rho * mu * t1, rho * p11, rho * p12, rho * mu * t2, rho * p12, rho * p22}};
}

// |r - P(r - u - mu |u_T| e_N)|^2, P the projection on the cone |r_T| <= mu r_N (De Saxce & Feng 1998).
inline double cone_residual(const double* r, const double* u, double mu) {
  const double zn = r[0] - u[0] - mu * std::sqrt(u[1] * u[1] + u[2] * u[2]);
  const double z1 = r[1] - u[1], z2 = r[2] - u[2], size = std::sqrt(z1 * z1 + z2 * z2);
  Vec3 foot = {zn, z1, z2};
  if (mu * size <= -zn) {
    foot = {};
  } else if (size > mu * zn) {
    const double normal = (zn + mu * size) / (1.0 + mu * mu);
    foot = {normal, mu * normal * z1 / size, mu * normal * z2 / size};
  }
  double sum = 0.0;
  for (int k = 0; k < 3; ++k) sum += (r[k] - foot[k]) * (r[k] - foot[k]);
  return sum;
}

}  // namespace voile
