// Parts of a surface that come near each other: a vertex and a triangle, an edge and another.
//
// Boxes around the parts lie in binary trees, whose order is that of the start: what is near along the
// surface stays near, so later positions change the boxes only.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "vec.hpp"

namespace voile {

struct Box {
  Vec low, high;
};

// Parts of `per` vertices each, in a tree: node i has the places begin[i] to end[i] of `order`, halves of
// them its children, 2i + 1 and 2i + 2.
class BoxTree {
 public:
  BoxTree(std::vector<int> vertex, int per, const double* x);

  // Boxes that parts do not leave on straight ways from x to `moved`, wider by `margin` (m).
  void enclose(const double* x, const double* moved, double margin);

  using Found = std::function<void(int, int)>;
  // Tells of all pairs of parts of two trees, or of one, once each, whose boxes meet.
  static void meet(const BoxTree& a, const BoxTree& b, const Found& found) { meet(a, 0, b, 0, found); }

  const int* corners(int part) const { return &vertex_[(size_t)per_ * part]; }
  int size() const { return (int)order_.size(); }

 private:
  void split(int node, int begin, int end, const std::vector<Vec>& middle);
  bool leaf(int node) const { return end_[node] - begin_[node] <= LEAF; }
  static void meet(const BoxTree& a, int i, const BoxTree& b, int j, const Found& found);

  static constexpr int LEAF = 4;
  std::vector<int> vertex_;
  int per_;
  std::vector<int> order_, begin_, end_;  // parts; places of nodes
  std::vector<Box> part_, node_;          // of the parts in that order, of the nodes
};

class Proximity {
 public:
  // n positions (m); (3m) vertices of triangles, (2e) of edges
  Proximity(std::span<const double> x, std::vector<int> triangles, std::vector<int> edges);

  // Codes, ascending, of the pairs without a common vertex that may come within `reach` (m) of each other on
  // straight ways from x to `moved`: by their distance at x, less how far their vertices go apart.
  // `faces`: triangle * n + vertex; `edges`: lower * e + higher.
  void pairs(const double* x, const double* moved, double reach, std::vector<int64_t>& faces,
             std::vector<int64_t>& edges);

  int vertices() const { return count_; }

 private:
  int count_;
  BoxTree points_, triangles_, edges_;
};

}  // namespace voile
