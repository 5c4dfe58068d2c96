#include "anderson.hpp"

#include <algorithm>

#include "blas.hpp"
#include "doubles.hpp"

namespace voile {
namespace {

constexpr int PIECE = 512;   // numbers of each vector that are worked on while they are near
const double FAINT = 1e-14;  // of the largest: singular values of the products that are round-off

VOILE_INLINED double product(const double* a, const double* b, int size) {
  double sum[8] = {};
  int i = 0;
  for (; i + 8 <= size; i += 8)
    for (int k = 0; k < 8; ++k) sum[k] += a[i + k] * b[i + k];
  for (; i < size; ++i) sum[0] += a[i] * b[i];
  for (int k = 1; k < 8; ++k) sum[0] += sum[k];
  return sum[0];
}

// Of `count` rows (count, stride) with two vectors, added to out (2, depth).
VOILE_CLONES void add_products(const double* rows, size_t stride, int count, const double* first,
                               const double* second, int size, int depth, double* out) {
  for (int k = 0; k < count; ++k) {
    out[k] += product(rows + stride * k, first, size);
    out[depth + k] += product(rows + stride * k, second, size);
  }
}

VOILE_CLONES void subtract(const double* rows, size_t stride, int count, const double* share, int size,
                           double* out) {
  for (int k = 0; k < count; ++k)
    for (int i = 0; i < size; ++i) out[i] -= share[k] * rows[stride * k + i];
}

}  // namespace

Memory::Memory(int size, int depth)
    : size(size),
      depth(depth),
      iterate(size),
      step(size),
      changes((size_t)size * depth),
      moves((size_t)size * depth),
      gram((size_t)depth * depth) {}

void Memory::add(const double* now, const double* stepped, double* out) {
  const bool more = begun && depth;
  const int newest = next;
  if (more) next = (next + 1) % depth, count = std::min(count + 1, depth);
  begun = true;
  std::fill(out, out + 2 * depth, 0.0);
  for (int from = 0; from < size; from += PIECE) {
    const int to = std::min(from + PIECE, size);
    if (more) {
      double *change = &changes[(size_t)size * newest], *move = &moves[(size_t)size * newest];
      for (int i = from; i < to; ++i) {
        change[i] = stepped[i] - step[i];
        move[i] = now[i] - iterate[i] + change[i];
      }
      add_products(&changes[from], size, count, change + from, stepped + from, to - from, depth, out);
    }
    std::copy(now + from, now + to, &iterate[from]);
    std::copy(stepped + from, stepped + to, &step[from]);
  }
}

std::vector<double> Memory::shares(const double* total) {
  const int newest = (next + depth - 1) % depth, one = 1, room = 8 * depth;
  for (int k = 0; k < count; ++k) gram[newest * depth + k] = gram[k * depth + newest] = total[k];
  std::vector<double> matrix, right(total + depth, total + depth + count), singular(count), work(room);
  for (int k = 0; k < count; ++k) matrix.insert(matrix.end(), &gram[k * depth], &gram[k * depth] + count);
  int rank, info;
  dgelss_(&count, &count, &one, matrix.data(), &count, right.data(), &count, singular.data(), &FAINT, &rank,
          work.data(), &room, &info);
  if (info) std::fill(right.begin(), right.end(), 0.0);
  return right;
}

void Memory::combine(const double* total, double* out) {
  const std::vector<double> share = count ? shares(total) : std::vector<double>{};
  for (int from = 0; from < size; from += PIECE) {
    const int to = std::min(from + PIECE, size);
    std::copy(&step[from], &step[from] + (to - from), out + from);
    subtract(&moves[from], size, count, share.data(), to - from, out + from);
  }
}

}  // namespace voile
