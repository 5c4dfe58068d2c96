#include "cholesky.hpp"

#include <algorithm>
#include <stdexcept>

#include "blas.hpp"
#include "definite.hpp"
#include "doubles.hpp"

namespace voile {
namespace {

typedef Double4 V;
constexpr int STRIP = 4;

VOILE_INLINED void transpose(V m[4]) {
  const V a = __builtin_shufflevector(m[0], m[1], 0, 4, 2, 6),
          b = __builtin_shufflevector(m[0], m[1], 1, 5, 3, 7);
  const V c = __builtin_shufflevector(m[2], m[3], 0, 4, 2, 6),
          d = __builtin_shufflevector(m[2], m[3], 1, 5, 3, 7);
  m[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5), m[1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  m[2] = __builtin_shufflevector(a, c, 2, 3, 6, 7), m[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

// Adds what MANY strips from the i-th on make of the columns' values `own`.
template <int SIDES, int MANY>
VOILE_INLINED void add(const Node& k, int i, const V* own, V* x) {
  V sum[MANY][4] = {};
  const V* strip = fours(k.panel) + (size_t)i * k.width;
  const int columns = std::min(k.width, STRIP * (i + MANY));  // zeros behind them
  for (int j = 0; j < columns; ++j) {
    const double* value = reinterpret_cast<const double*>(own + j);
    for (int s = 0; s < MANY; ++s)
      for (int side = 0; side < SIDES; ++side) sum[s][side] += strip[(size_t)s * k.width + j] * value[side];
  }
  for (int s = 0; s < MANY; ++s) {
    transpose(sum[s]);
    for (int r = 0; r < STRIP; ++r) x[k.rows[STRIP * (i + s) + r]] += sum[s][r];
  }
}

template <int SIDES>
VOILE_INLINED void forward(const Node& k, V* own, V* x) {
  for (int j = 0; j < k.width; ++j) own[j] = x[k.first + j], x[k.first + j] = V{};
  int i = 0;
  for (; i + 2 <= k.strips; i += 2) add<SIDES, 2>(k, i, own, x);
  if (i < k.strips) add<SIDES, 1>(k, i, own, x);
}

// What all strips make of their rows' values, (strips, SIDES), in MANY columns from the j-th on.
template <int SIDES, int MANY>
VOILE_INLINED void gather(const Node& k, int j, const V* values, V* x) {
  V sum[MANY][4] = {};
  const int first = j / STRIP;  // zeros before
  const V* strip = fours(k.panel) + (size_t)first * k.width + j;
  for (int i = first; i < k.strips; ++i, strip += k.width)
    for (int c = 0; c < MANY; ++c)
      for (int side = 0; side < SIDES; ++side) sum[c][side] += strip[c] * values[SIDES * i + side];
  for (int c = 0; c < MANY; ++c) {
    transpose(sum[c]);
    x[k.first + j + c] = (sum[c][0] + sum[c][1]) + (sum[c][2] + sum[c][3]);
  }
}

template <int SIDES>
VOILE_INLINED void backward(const Node& k, V* values, V* x) {
  for (int i = 0; i < k.strips; ++i) {
    V rows[4];
    for (int r = 0; r < STRIP; ++r) rows[r] = x[k.rows[STRIP * i + r]];
    transpose(rows);
    for (int side = 0; side < SIDES; ++side) values[SIDES * i + side] = rows[side];
  }
  int j = 0;
  for (; j + 4 <= k.width; j += 4) gather<SIDES, 4>(k, j, values, x);
  for (; j < k.width; ++j) gather<SIDES, 1>(k, j, values, x);
}

template <int SIDES>
VOILE_INLINED void both(const std::vector<Node>& nodes, V* values, V* x) {
  for (auto k = nodes.begin(); k != nodes.end(); ++k) forward<SIDES>(*k, values, x);
  for (auto k = nodes.rbegin(); k != nodes.rend(); ++k) backward<SIDES>(*k, values, x);
}

VOILE_CLONES void sweep(const std::vector<Node>& nodes, int sides, V* values, V* x) {
  sides == 1 ? both<1>(nodes, values, x) : both<3>(nodes, values, x);
}

}  // namespace

Cholesky::Cholesky(int size, const int32_t* start, const int32_t* column, const double* value) {
  Definite made(std::make_shared<Fronts>(size, start, column, 1));
  if (!made.factor(value)) throw std::runtime_error("the matrix is not positive definite");
  const Fronts& by = made.by();
  order.assign(by.order(), by.order() + size);
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
          panel.push_back(r < f.height ? front[r + (size_t)j * f.height] : 0.0);
    most = std::max({most, 3 * (size_t)strips, (size_t)f.width});
  }
  const double* next = panel.data();
  for (size_t s = 0; s < nodes.size(); ++s) {
    nodes[s].rows = rows.data() + starts[s], nodes[s].panel = next;
    next += (size_t)STRIP * nodes[s].strips * nodes[s].width;
  }
  work.resize(4 * ((size_t)size + 1));
  values.resize(4 * most);
}

void Cholesky::solve(double* b, int count) {
  const int size = this->size();
  for (int i = 0; i < size; ++i)
    for (int k = 0; k < count; ++k) work[4 * i + k] = b[(size_t)k * size + order[i]];
  sweep(nodes, count, fours(values.data()), fours(work.data()));
  for (int i = 0; i < size; ++i)
    for (int k = 0; k < count; ++k) b[(size_t)k * size + order[i]] = work[4 * i + k];
}

}  // namespace voile
