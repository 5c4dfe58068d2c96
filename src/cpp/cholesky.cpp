#include "cholesky.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>

#include "blas.hpp"
#include "definite.hpp"
#include "doubles.hpp"

namespace voile {
namespace {

// Of the right-hand sides at a row; of one at the rows of a strip.
typedef float Sides __attribute__((vector_size(16), aligned(4), may_alias));
typedef float Strip __attribute__((vector_size(32), aligned(4), may_alias));
constexpr int STRIP = 8;

VOILE_INLINED const Strip* strips(const Node& k) { return reinterpret_cast<const Strip*>(k.panel); }

VOILE_INLINED void transpose(Sides m[4]) {
  const Sides a = __builtin_shufflevector(m[0], m[1], 0, 4, 2, 6),
              b = __builtin_shufflevector(m[0], m[1], 1, 5, 3, 7);
  const Sides c = __builtin_shufflevector(m[2], m[3], 0, 4, 2, 6),
              d = __builtin_shufflevector(m[2], m[3], 1, 5, 3, 7);
  m[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5), m[1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  m[2] = __builtin_shufflevector(a, c, 2, 3, 6, 7), m[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

VOILE_INLINED Sides half(const Strip& s, int which) {
  return which ? __builtin_shufflevector(s, s, 4, 5, 6, 7) : __builtin_shufflevector(s, s, 0, 1, 2, 3);
}

// Adds what MANY strips from the i-th on make of the columns' values `own`.
template <int SIDES, int MANY>
VOILE_INLINED void add(const Node& k, int i, const Sides* own, Sides* x) {
  Strip sum[MANY][SIDES] = {};
  const Strip* strip = strips(k) + (size_t)i * k.width;
  const int columns = std::min(k.width, STRIP * (i + MANY));  // zeros behind them
  for (int j = 0; j < columns; ++j) {
    const float* value = reinterpret_cast<const float*>(own + j);
    for (int s = 0; s < MANY; ++s)
      for (int side = 0; side < SIDES; ++side) sum[s][side] += strip[(size_t)s * k.width + j] * value[side];
  }
  for (int s = 0; s < MANY; ++s)
    for (int part = 0; part < 2; ++part) {
      Sides rows[4] = {};
      for (int side = 0; side < SIDES; ++side) rows[side] = half(sum[s][side], part);
      transpose(rows);
      for (int r = 0; r < 4; ++r) x[k.rows[STRIP * (i + s) + 4 * part + r]] += rows[r];
    }
}

template <int SIDES>
VOILE_INLINED void forward(const Node& k, Sides* own, Sides* x) {
  for (int j = 0; j < k.width; ++j) own[j] = x[k.first + j], x[k.first + j] = Sides{};
  int i = 0;
  for (; i + 2 <= k.strips; i += 2) add<SIDES, 2>(k, i, own, x);
  if (i < k.strips) add<SIDES, 1>(k, i, own, x);
}

// What all strips make of their rows' values, (strips, SIDES), in MANY columns from the j-th on.
template <int SIDES, int MANY>
VOILE_INLINED void gather(const Node& k, int j, const Strip* values, Sides* x) {
  Strip sum[MANY][SIDES] = {};
  const int first = j / STRIP;  // zeros before
  const Strip* strip = strips(k) + (size_t)first * k.width + j;
  for (int i = first; i < k.strips; ++i, strip += k.width)
    for (int c = 0; c < MANY; ++c)
      for (int side = 0; side < SIDES; ++side) sum[c][side] += strip[c] * values[SIDES * i + side];
  for (int c = 0; c < MANY; ++c) {
    Sides parts[4] = {};
    for (int side = 0; side < SIDES; ++side) parts[side] = half(sum[c][side], 0) + half(sum[c][side], 1);
    transpose(parts);
    x[k.first + j + c] = (parts[0] + parts[1]) + (parts[2] + parts[3]);
  }
}

template <int SIDES>
VOILE_INLINED void backward(const Node& k, Strip* values, Sides* x) {
  for (int i = 0; i < k.strips; ++i)
    for (int part = 0; part < 2; ++part) {
      Sides rows[4];
      for (int r = 0; r < 4; ++r) rows[r] = x[k.rows[STRIP * i + 4 * part + r]];
      transpose(rows);
      for (int side = 0; side < SIDES; ++side)
        reinterpret_cast<Sides*>(values + SIDES * i + side)[part] = rows[side];
    }
  int j = 0;
  for (; j + 4 <= k.width; j += 4) gather<SIDES, 4>(k, j, values, x);
  for (; j < k.width; ++j) gather<SIDES, 1>(k, j, values, x);
}

template <int SIDES>
VOILE_INLINED void both(const std::vector<Node>& nodes, float* work, Sides* x) {
  Strip* values = reinterpret_cast<Strip*>(work);
  for (auto k = nodes.begin(); k != nodes.end(); ++k) forward<SIDES>(*k, reinterpret_cast<Sides*>(work), x);
  for (auto k = nodes.rbegin(); k != nodes.rend(); ++k) backward<SIDES>(*k, values, x);
}

VOILE_CLONES void sweep(const std::vector<Node>& nodes, int sides, float* work, float* x) {
  Sides* at = reinterpret_cast<Sides*>(x);
  sides == 1 ? both<1>(nodes, work, at) : both<3>(nodes, work, at);
}

}  // namespace

Cholesky::Cholesky(int size, const int32_t* start, const int32_t* column, const double* value, int sides,
                   const int32_t* places)
    : sides(sides), furthest(*std::max_element(places, places + (size_t)sides * size)) {
  Definite made(std::make_shared<Fronts>(size, start, column, 1));
  if (!made.factor(value)) throw std::runtime_error("the matrix is not positive definite");
  const Fronts& by = made.by();
  for (int i = 0; i < size; ++i) {
    const int row = by.order()[i];
    for (int k = 0; k < sides; ++k) place.push_back(places[(size_t)k * size + row]);
    sums.push_back(std::accumulate(value + start[row], value + start[row + 1], 0.0));
  }
  total = std::accumulate(sums.begin(), sums.end(), 0.0);
  std::vector<double> front;
  std::vector<size_t> starts;
  size_t most = 0;
  for (const Front& f : by.all) {
    const double* from = made.panels() + f.panel;
    front.assign(from, from + (size_t)f.height * f.width);
    for (int j = 0; j < f.width; ++j)
      for (int i = 0; i < f.height; ++i) {
        double& entry = front[i + (size_t)j * f.height];
        entry = i < f.width ? i == j : -entry;
      }
    const double one = 1.0;
    dtrsm_("R", "L", "N", "N", &f.height, &f.width, &one, from, &f.height, front.data(), &f.height);
    const int strips = (f.height + STRIP - 1) / STRIP;
    starts.push_back(rows.size());
    nodes.push_back({f.first, f.width, strips, nullptr, nullptr});
    rows.insert(rows.end(), f.rows, f.rows + f.height);
    rows.resize(starts.back() + (size_t)STRIP * strips, size);
    for (int i = 0; i < STRIP * strips; i += STRIP)
      for (int j = 0; j < f.width; ++j)
        for (int r = i; r < i + STRIP; ++r)
          panel.push_back(r < f.height ? (float)front[r + (size_t)j * f.height] : 0.0f);
    most = std::max({most, 3 * (size_t)strips * STRIP, 4 * (size_t)f.width});
  }
  const float* next = panel.data();
  for (size_t s = 0; s < nodes.size(); ++s) {
    nodes[s].rows = rows.data() + starts[s], nodes[s].panel = next;
    next += (size_t)STRIP * nodes[s].strips * nodes[s].width;
  }
  work.resize(4 * ((size_t)size + 1));
  values.resize(most);
}

void Cholesky::solve(const double* b, double* x) {
  double whole[3] = {};  // a motion of all alike, which the sheet that falls has to round-off
  const int* at = place.data();
  for (size_t i = 0; i < sums.size(); ++i)
    for (int k = 0; k < sides; ++k) whole[k] += b[*at++];
  for (double& motion : whole) motion /= total;
  at = place.data();
  for (size_t i = 0; i < sums.size(); ++i)
    for (int k = 0; k < sides; ++k) work[4 * i + k] = (float)(b[*at++] - sums[i] * whole[k]);
  sweep(nodes, sides, values.data(), work.data());
  at = place.data();
  for (size_t i = 0; i < sums.size(); ++i)
    for (int k = 0; k < sides; ++k) x[*at++] = whole[k] + work[4 * i + k];
}

}  // namespace voile
