// Anderson's acceleration of a fixed-point iteration (Walker & Ni 2011, type II), of which several ranks may
// hold parts.
#pragma once

#include <cstddef>
#include <vector>

namespace voile {

class Memory {
 public:
  Memory(int size, int depth);
  void forget() { count = next = 0, begun = false; }
  size_t length() const { return iterate.size(); }
  size_t sums() const { return 2 * depth; }
  // An iterate and the step from it (size); what they changed by since the last ones is kept, the oldest
  // dropped. To out (2 depth): scalar products of the newest change of a step with all kept ones, and those
  // of this step, for other ranks' to be added.
  void add(const double* iterate, const double* step, double* out);
  // To out (size): step - sum_k share_k (change of the iterate + change of its step), for the last step, with
  // the shares that leave least of it in the changes whose products `total` sums over ranks.
  void combine(const double* total, double* out);

 private:
  std::vector<double> shares(const double* total);

  int size, depth, count = 0, next = 0;
  bool begun = false;
  std::vector<double> iterate, step;   // the last ones
  std::vector<double> changes, moves;  // (depth, size): of the steps; of iterates and steps together
  std::vector<double> gram;            // (depth, depth) products of changes
};

}  // namespace voile
