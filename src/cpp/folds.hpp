// Hinges near 180 degrees and on through them.
#pragma once

#include "blocks.hpp"

namespace voile {
inline namespace VOILE_ISA {

// Tells the blocks the sides of their half edges (3m); empty: all as they are.
inline void mark_sides(const std::vector<int>& sides, std::vector<Block>& blocks) {
  for (size_t half = 0; half < sides.size(); ++half) {
    const int t = (int)half / 3, i = (int)half % 3;
    blocks[t / LANES].side[i][t % LANES] = (float)sides[half];
  }
}

// The sides from which the hinges of a block go on that are within 90 degrees of 180.
inline void store_sides(const Block& block, const Local& w, int* out) {
  for (int lane = 0; lane < block.count; ++lane)
    for (int i = 0; i < 3; ++i)
      if (std::abs(w.q.c[i][lane]) < M_SQRT1_2)
        out[3 * (block.first + lane) + i] = w.q.s[i][lane] < 0.0 ? -1 : 1;
}

// Whether a hinge of a block turns through 180 degrees from one shape to another. Those within 0.1 degrees of
// it at the start do not count: it is not known on which side they are.
inline bool turns_through(const Block& block, const Local& before, const Local& after) {
  constexpr double closed = 1e-3;  // cosine of half a hinge's angle
  for (int i = 0; i < 3; ++i)
    for (int lane = 0; lane < block.count; ++lane) {
      const double from = before.q.c[i][lane], to = after.q.c[i][lane];
      if (from > closed && from * to + before.q.s[i][lane] * after.q.s[i][lane] <= 0.0) return true;
    }
  return false;
}

}  // namespace VOILE_ISA
}  // namespace voile
