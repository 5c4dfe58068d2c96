// How sparse matrices of one pattern are factored: in which order, and by which dense fronts.
#pragma once

#include <cholmod.h>

#include <cstdint>
#include <vector>

namespace voile {

// A supernode: `width` columns with the same rows, `height` in all, its own first. They are factored in a
// dense front of these rows, which adds to fronts after it (multifrontal method, Duff & Reid 1983; Liu 1992).
// panel: place of its columns (height x width); across: of its rows beyond them, transposed (below x width);
// into: that of its rows below in `Fronts::place`; child, sibling: the last front that adds to it, the one
// before that adds to the same; -1 for none.
struct Front {
  int first, width, height;
  const int32_t* rows;
  size_t panel, across, into;
  int child, sibling;
  int below() const { return height - width; }
};

// CHOLMOD (Davis et al., SuiteSparse) orders and analyses.
class Fronts {
 public:
  // Rows of the pattern, which is symmetric, both triangles, columns ascending. Throws std::runtime_error.
  Fronts(int size, const int32_t* start, const int32_t* column);
  ~Fronts();
  Fronts(const Fronts&) = delete;
  Fronts& operator=(const Fronts&) = delete;

  // An entry of the matrix, and where it goes: among all panels, or after them among what is across.
  struct Entry {
    int32_t from;
    size_t to;
  };

  int size() const { return (int)made->n; }
  size_t panels() const { return made->xsize; }

  int given;  // entries of the matrix
  cholmod_common common;
  cholmod_factor* made = nullptr;
  std::vector<Front> all;       // children before parents
  std::vector<Entry> entries;   // those of the lower triangle first
  size_t triangle = 0;          // how many these are
  size_t across = 0;            // numbers there
  std::vector<int32_t> place;   // of fronts' rows below among the parent's
  std::vector<double> updates;  // a stack of what fronts add
};

}  // namespace voile
