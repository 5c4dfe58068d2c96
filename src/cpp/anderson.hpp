// Memory of an accelerated fixed-point iteration: its last `depth` changes, and sums of them.
#pragma once

#include <cstddef>
#include <vector>

namespace voile {

class Memory {
 public:
  Memory(int size, int depth);
  void forget() { count = next = 0, begun = false; }
  int kept() const { return count; }
  size_t length() const { return iterate.size(); }
  size_t most() const { return depth; }
  // An iterate and the step from it (size); what they changed by since the last ones is kept, the oldest
  // dropped.
  void add(const double* iterate, const double* step);
  // Scalar products of the newest change of a step with all kept ones, then those of the last step (2 depth).
  void products(double* out) const;
  // step - sum_k share[k] (change of the iterate + change of its step), for the last step.
  void combine(const double* share, double* out) const;
  int newest() const { return (next + depth - 1) % depth; }

 private:
  int size, depth, count = 0, next = 0;
  bool begun = false;
  std::vector<double> iterate, step;   // the last ones
  std::vector<double> changes, moves;  // (depth, size): of the steps; of iterates and steps together
};

}  // namespace voile
