#include "friction.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "block_lu.hpp"
#include "coulomb.hpp"

namespace voile {

namespace {

using Vector = std::vector<double>;

constexpr double EPS_MIN = 1e-12, EPS_START = 1.0, EPS_MAX = 1e4;  // W's diagonal is about 1
constexpr double REDUCTION = 0.3;  // of |F|: a proximal step is solved no further
// Where no reactions satisfy the laws they grow without bound, and so does what the error is relative to. So
// the natural map must also be small relative to the velocities without reactions, and reactions beyond the
// second bound, where round-off hides those velocities, end the search. Both in scaled numbers.
constexpr double COMPATIBLE = 1e-3, UNBOUNDED = 1e10;
constexpr int NEWTON_STEPS = 20, HALVINGS = 12;
// The natural map's scale, in turn where Newton fails: W's soft modes want far more than its diagonal.
constexpr double RHO[] = {1.0, 10.0, 100.0, 1000.0};
constexpr double FASTEST = 0.01;  // largest reduction of eps at once

double norm(const Vector& v) {
  double sum = 0.0;
  for (double x : v) sum += x * x;
  return std::sqrt(sum);
}

Mat3 product(const Mat3& a, const double* b) {
  Mat3 c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return c;
}

void subtract_product(double* y, const Mat3& a, const double* x) {
  for (int i = 0; i < 3; ++i) y[i] -= a[3 * i] * x[0] + a[3 * i + 1] * x[1] + a[3 * i + 2] * x[2];
}

// One point: reactions, velocities u = W r + q and natural map of the proximal problem there.
struct Point {
  Vector r, u, F;
  double size = 0.0;  // |F|
};

class Solver {
 public:
  Solver(const FrictionProblem& problem, double tol, int max_iterations)
      : n_((int)problem.mu.size()),
        start_(problem.start),
        column_(problem.column),
        mu_(problem.mu),
        blocks_(problem.blocks.begin(), problem.blocks.end()),
        q_(problem.q.begin(), problem.q.end()),
        tol_(tol),
        max_iterations_(max_iterations),
        lu_(n_, start_, column_),
        jacobian_(blocks_.size()),
        map_(n_),
        active_(n_),
        slope_(3 * n_) {
    scale();
  }

  FrictionSolution run();

 private:
  int n_;
  std::span<const int> start_, column_;
  std::span<const double> mu_;
  Vector blocks_, q_;  // scaled
  Vector scale_;       // per contact: r = force_ scale_ r', u = force_ / scale_ u'
  double force_ = 1.0;
  double tol_;
  int max_iterations_;
  BlockLU lu_;
  Vector jacobian_;
  std::vector<NaturalMap> map_;
  std::vector<char> active_;
  Vector slope_;  // W step
  FrictionSolution best_;

  void scale();
  void multiply(const Vector& r, Vector& u) const;
  bool test(const Point& p);
  void evaluate(Point& p, const Vector& centre, double eps, double rho) const;
  bool newton_step(const Point& p, const Vector& centre, double eps, double rho, Vector& step);
  bool line_search(Point& p, const Vector& step, const Vector& centre, double eps, double rho);
};

// Each contact by the mean of its diagonal block, q to a mean of 1: settings then fit every problem.
void Solver::scale() {
  scale_.assign(n_, 1.0);
  for (int i = 0; i < n_; ++i)
    for (int e = start_[i]; e < start_[i + 1]; ++e) {
      const double* w = &blocks_[9 * e];
      const double mean = (w[0] + w[4] + w[8]) / 3.0;
      if (column_[e] == i && mean > 0.0) scale_[i] = 1.0 / std::sqrt(mean);
    }
  for (int i = 0; i < n_; ++i) {
    for (int e = start_[i]; e < start_[i + 1]; ++e)
      for (int k = 0; k < 9; ++k) blocks_[9 * e + k] *= scale_[i] * scale_[column_[e]];
    for (int k = 0; k < 3; ++k) q_[3 * i + k] *= scale_[i];
  }
  const double size = norm(q_) / std::sqrt((double)n_);
  if (size > 0.0) force_ = size;
  for (double& x : q_) x /= force_;
}

// u = W r
void Solver::multiply(const Vector& r, Vector& u) const {
  for (int i = 0; i < n_; ++i) {
    double a = 0.0, b = 0.0, c = 0.0;
    for (int e = start_[i]; e < start_[i + 1]; ++e) {
      const double *w = &blocks_[9 * e], *x = &r[3 * column_[e]];
      a += w[0] * x[0] + w[1] * x[1] + w[2] * x[2];
      b += w[3] * x[0] + w[4] * x[1] + w[5] * x[2];
      c += w[6] * x[0] + w[7] * x[1] + w[8] * x[2];
    }
    u[3 * i] = a, u[3 * i + 1] = b, u[3 * i + 2] = c;
  }
}

// Measures the error in the problem's own units and keeps the best point; true if it is within the tolerance.
bool Solver::test(const Point& p) {
  double miss = 0.0, scaled_miss = 0.0, rr = 0.0, uu = 0.0, qq = 0.0;
  for (int i = 0; i < n_; ++i) {
    Vec3 r, u;
    for (int k = 0; k < 3; ++k) {
      r[k] = p.r[3 * i + k] * force_ * scale_[i];
      u[k] = p.u[3 * i + k] * force_ / scale_[i];
      const double q = q_[3 * i + k] * force_ / scale_[i];
      rr += r[k] * r[k], uu += u[k] * u[k], qq += q * q;
    }
    miss += cone_residual(r.data(), u.data(), mu_[i]);
    scaled_miss += cone_residual(&p.r[3 * i], &p.u[3 * i], mu_[i]);
  }
  const double size = std::sqrt(std::max({rr, uu, qq}));
  const double error = std::sqrt(miss) / (size > std::numeric_limits<double>::epsilon() ? size : 1.0);
  best_.history.push_back(error);
  if (best_.reaction.empty() || error < best_.error) {
    best_.error = error;
    best_.reaction = p.r;
  }
  best_.converged = error <= tol_ && std::sqrt(scaled_miss) <= COMPATIBLE * norm(q_);
  return best_.converged;
}

void Solver::evaluate(Point& p, const Vector& centre, double eps, double rho) const {
  double sum = 0.0;
  for (int i = 0; i < n_; ++i) {
    Vec3 u;
    for (int k = 0; k < 3; ++k) u[k] = p.u[3 * i + k] + eps * (p.r[3 * i + k] - centre[3 * i + k]);
    const NaturalMap m = natural_map(&p.r[3 * i], u.data(), mu_[i], rho);
    for (int k = 0; k < 3; ++k) sum += m.F[k] * m.F[k], p.F[3 * i + k] = m.F[k];
  }
  p.size = std::sqrt(sum);
}

// Solves (A + B (W + eps)) step = -F; where a contact is open, step = -r at once.
bool Solver::newton_step(const Point& p, const Vector& centre, double eps, double rho, Vector& step) {
  for (int i = 0; i < n_; ++i) {
    Vec3 u;
    for (int k = 0; k < 3; ++k) u[k] = p.u[3 * i + k] + eps * (p.r[3 * i + k] - centre[3 * i + k]);
    map_[i] = natural_map(&p.r[3 * i], u.data(), mu_[i], rho);
    active_[i] = map_[i].state != ContactState::open;
    for (int k = 0; k < 3; ++k) step[3 * i + k] = -map_[i].F[k];
  }
  for (int i = 0; i < n_; ++i) {
    if (!active_[i]) continue;
    const NaturalMap& m = map_[i];
    for (int e = start_[i]; e < start_[i + 1]; ++e) {
      const int j = column_[e];
      const Mat3 block = product(m.B, &blocks_[9 * e]);
      double* to = &jacobian_[9 * e];
      if (!active_[j]) {
        subtract_product(&step[3 * i], block, &step[3 * j]);
        continue;
      }
      for (int k = 0; k < 9; ++k) to[k] = block[k] + (i == j ? m.A[k] + eps * m.B[k] : 0.0);
    }
  }
  ++best_.factorisations;
  if (!lu_.factor(jacobian_, active_)) return false;
  lu_.solve(step);
  return std::ranges::all_of(step, [](double x) { return std::isfinite(x); });
}

// Goes along the step until |F| falls; false if it does not.
bool Solver::line_search(Point& p, const Vector& step, const Vector& centre, double eps, double rho) {
  multiply(step, slope_);
  Point trial = p;
  double length = 1.0;
  for (int h = 0; h <= HALVINGS; ++h, length *= 0.5) {
    for (int k = 0; k < 3 * n_; ++k) {
      trial.r[k] = p.r[k] + length * step[k];
      trial.u[k] = p.u[k] + length * slope_[k];
    }
    evaluate(trial, centre, eps, rho);
    if (trial.size < p.size) {
      p = std::move(trial);
      return true;
    }
  }
  return false;
}

// By how much of the reduction eps falls after that many Newton steps.
double ease(int steps) { return steps <= 1 ? 1.0 : steps <= 5 ? 0.5 : steps <= 15 ? 0.25 : 0.0; }

FrictionSolution Solver::run() {
  Point p{Vector(3 * n_), q_, Vector(3 * n_)};
  Vector start(3 * n_), centre(3 * n_), step(3 * n_);
  bool done = test(p);
  double eps = EPS_START, reduction = FASTEST;
  int failures = 0, total_failures = 0;
  auto more = [&] { return !done && best_.factorisations < max_iterations_; };
  while (more() && best_.proximal_steps < max_iterations_ && norm(centre) < UNBOUNDED * norm(q_)) {
    ++best_.proximal_steps;
    const double rho = RHO[total_failures % std::size(RHO)];
    p.r = start;
    multiply(p.r, p.u);
    for (int k = 0; k < 3 * n_; ++k) p.u[k] += q_[k];
    evaluate(p, centre, eps, rho);
    const double first = p.size;
    int steps = 0;
    bool solved = first == 0.0;
    while (!solved && more() && steps < NEWTON_STEPS && newton_step(p, centre, eps, rho, step) &&
           line_search(p, step, centre, eps, rho)) {
      ++steps, ++best_.iterations;
      done = test(p);
      solved = p.size <= REDUCTION * first;
    }
    if (solved) {
      start = centre = p.r;
      eps = std::max(EPS_MIN, eps * std::pow(reduction, ease(steps)));
      reduction = std::max(FASTEST, std::pow(reduction, 1.2));
      failures = 0;
    } else {
      start = p.size < 0.9 * first ? p.r : centre;
      eps = std::min(EPS_MAX, eps * std::pow(2.0, std::min(++failures, 2)));
      reduction = std::sqrt(reduction);
      ++total_failures;
    }
  }
  for (int i = 0; i < n_; ++i)
    for (int k = 0; k < 3; ++k) best_.reaction[3 * i + k] *= force_ * scale_[i];
  return best_;
}

}  // namespace

FrictionSolution solve_friction(const FrictionProblem& problem, double tol, int max_iterations) {
  return Solver(problem, tol, max_iterations).run();
}

}  // namespace voile
