#include "anderson.hpp"

#include <algorithm>

#include "doubles.hpp"

namespace voile {

Memory::Memory(int size, int depth)
    : size(size),
      depth(depth),
      iterate(size),
      step(size),
      changes((size_t)size * depth),
      moves((size_t)size * depth) {}

void Memory::add(const double* now, const double* stepped) {
  if (begun && depth) {
    double *change = &changes[(size_t)size * next], *move = &moves[(size_t)size * next];
    for (int i = 0; i < size; ++i) {
      change[i] = stepped[i] - step[i];
      move[i] = now[i] - iterate[i] + change[i];
    }
    next = (next + 1) % depth, count = std::min(count + 1, depth);
  }
  std::copy(now, now + size, iterate.begin());
  std::copy(stepped, stepped + size, step.begin());
  begun = true;
}

VOILE_CLONES static double product(const double* a, const double* b, int size) {
  double sum[8] = {};
  int i = 0;
  for (; i + 8 <= size; i += 8)
    for (int k = 0; k < 8; ++k) sum[k] += a[i + k] * b[i + k];
  for (; i < size; ++i) sum[0] += a[i] * b[i];
  for (int k = 1; k < 8; ++k) sum[0] += sum[k];
  return sum[0];
}

void Memory::products(double* out) const {
  std::fill(out, out + 2 * depth, 0.0);
  for (int k = 0; k < count; ++k) {
    const double* change = &changes[(size_t)size * k];
    out[k] = product(change, &changes[(size_t)size * newest()], size);
    out[depth + k] = product(change, step.data(), size);
  }
}

void Memory::combine(const double* share, double* out) const {
  std::copy(step.begin(), step.end(), out);
  for (int k = 0; k < count; ++k) {
    const double* move = &moves[(size_t)size * k];
    for (int i = 0; i < size; ++i) out[i] -= share[k] * move[i];
  }
}

}  // namespace voile
