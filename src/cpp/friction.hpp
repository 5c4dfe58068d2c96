// Discrete frictional contact: reactions r and velocities u = W r + q of c contacts that satisfy Signorini's
// and Coulomb's laws. W (Delassus operator) is sparse in 3 by 3 blocks, may be singular, indefinite by
// round-off and slightly unsymmetric.
//
// Proximal-point method (Rockafellar 1976) around a semismooth Newton method for Alart & Curnier's natural
// map: u = W r + q + eps (r - centre) is solved for a sequence of centres; eps falls as long as Newton
// succeeds and rises where it fails. Contacts without reaction drop out of Newton's linear systems.
#pragma once

#include <span>
#include <vector>

namespace voile {

struct FrictionProblem {
  std::span<const int> start, column;  // block rows of W, compressed; each with its diagonal block
  std::span<const double> blocks;      // (nonzeros, 3, 3) row-major
  std::span<const double> q, mu;       // (c, 3), (c)
};

struct FrictionSolution {
  std::vector<double> reaction;  // (c, 3), the best found
  bool converged = false;        // error <= tol and compatible: reactions did not grow without bound
  double error = 0.0;            // |r - P(r - u_hat)| / max(|q|, |r|, |u|)
  int proximal_steps = 0, iterations = 0, factorisations = 0;
  std::vector<double> history;  // error after every Newton step
};

// Stops at error <= tol, or after max_iterations Newton systems or proximal steps.
FrictionSolution solve_friction(const FrictionProblem& problem, double tol, int max_iterations);

}  // namespace voile
