// How sparse matrices of one pattern are factored: in which order, and by which dense fronts.
#pragma once

#include <cholmod.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "team.hpp"

namespace voile {

// Two entries of the matrix across its diagonal, the lower one first, and the lower one's row in its front.
struct Pair {
  int32_t lower, upper, row;
};

// A supernode: `width` columns with the same rows, `height` in all, its own first. They are factored in a
// dense front of these rows, which adds to fronts after it (multifrontal method, Duff & Reid 1983; Liu 1992).
// panel: place of its columns (height x width); across: of its rows beyond them, transposed (below x width);
// into: that of its rows below in `Fronts::place`; parent: the front that it adds to; child, sibling: the
// last front that adds to it, the one before that adds to the same; -1 for none. lane: see `Fronts::lanes`.
struct Front {
  int first, width, height;
  const int32_t* rows;
  size_t panel, across, into = 0;
  int parent = -1, child = -1, sibling = -1, lane = 0;
  int below() const { return height - width; }
  size_t adds() const { return (size_t)below() * below(); }
  double work() const {  // operations of its elimination
    const double w = width, h = height;
    return w * (h * h - h * w + w * w / 3.0);
  }
  // Rows or columns that one thread takes at a time: all but of fronts that take a thread 1 ms. Half as many
  // or twice as many take as long.
  int piece() const { return shared() ? 128 : height; }
  bool shared() const { return work() > 2e7; }
};

// Of all factors of a pattern, which take turns; CHOLMOD (Davis et al., SuiteSparse) orders and analyses.
class Fronts {
 public:
  // Rows of the pattern, which is symmetric, both triangles, columns ascending; threads: how many factor at
  // most. Throws std::runtime_error.
  Fronts(int size, const int32_t* start, const int32_t* column, int threads);
  ~Fronts();
  Fronts(const Fronts&) = delete;
  Fronts& operator=(const Fronts&) = delete;

  int size() const { return (int)made->n; }
  size_t panels() const { return made->xsize; }
  const int32_t* order() const { return static_cast<const int32_t*>(made->Perm); }
  // The matrix' entries in a column of the order, and in the row across.
  std::span<const Pair> pairs(int column) const {
    return std::span(entries).subspan(begin[column], begin[column + 1] - begin[column]);
  }

  // Calls eliminate(front, sum, team) for all fronts, children first, until one is false; whether all were
  // true. It leaves in sum (below x below) what the front adds to its parent. Subtrees are run in threads,
  // and the fronts above them one by one, each by the team of all. Where sums come from, and in which order,
  // does not depend on the threads.
  using Eliminate = std::function<bool(const Front&, double*, Team&)>;
  bool run(const Eliminate& eliminate);
  // What a child of a front being eliminated adds to it.
  const double* added(int child) const { return sums[child]; }

  // Threads that are worth their start in a sweep over all panels.
  int sweepers() const { return panels() > SWEPT ? subtrees() : 1; }
  // Calls visit(front) for all fronts, children first, subtrees by one of the team each.
  template <class Visit>
  void upwards(Team& team, const Visit& visit) const {
    team.share(subtrees(), [&](int lane) {
      for (int k : lanes[lane]) visit(all[k]);
    });
    if (lanes.size() > 1)
      for (int k : lanes.back()) visit(all[k]);
  }
  // Parents first.
  template <class Visit>
  void downwards(Team& team, const Visit& visit) const {
    const auto down = [&](int lane) {
      for (auto k = lanes[lane].rbegin(); k != lanes[lane].rend(); ++k) visit(all[*k]);
    };
    if (lanes.size() > 1) down(subtrees());
    team.share(subtrees(), down);
  }

  int given;  // entries of the matrix
  cholmod_common common;
  cholmod_factor* made = nullptr;
  std::vector<Front> all;      // children before parents
  size_t across = 0;           // numbers there
  std::vector<int32_t> place;  // of fronts' rows below among the parent's

 private:
  static constexpr size_t SWEPT = 1 << 20;  // numbers, which take 1 ms in both sweeps
  int subtrees() const { return lanes.size() > 1 ? (int)lanes.size() - 1 : 1; }
  void take(const int32_t* start, const int32_t* column);
  void share();
  void line_up();
  void run(int lane, Team& team, const Eliminate& eliminate);

  int threads;
  std::vector<Pair> entries;
  std::vector<int32_t> begin;  // of columns among them
  // Fronts, children first: whole subtrees, a lane for each thread, and last what they all lead to.
  std::vector<std::vector<int>> lanes;
  std::vector<std::vector<double>> stacks;  // of what each lane's fronts add
  std::vector<double*> sums;                // of each front
  std::atomic<int> broken = -1;             // a front that was not eliminated
  int breaks = 0;                           // runs that broke off
  std::vector<int> late;                    // the last of them in each front's subtree
};

}  // namespace voile
