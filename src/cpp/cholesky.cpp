#include "cholesky.hpp"

#include <stdexcept>

#include "definite.hpp"
#include "doubles.hpp"

namespace voile {
namespace {

constexpr int SIDES = 4;

VOILE_INLINED void forward(const Node& k, Double4* x) {
  using V = Double4;
  V* own = x + k.first;
  const double* row = k.panel;
  for (int i = 0; i < k.width; ++i, row += k.width) {
    V sum = own[i];
    for (int j = 0; j < i; ++j) sum -= row[j] * own[j];
    own[i] = sum * row[i];
  }
  int i = 0;
  for (; i + 4 <= k.height; i += 4, row += 4 * k.width) {
    V a = {}, b = {}, c = {}, d = {};
    for (int j = 0; j < k.width; ++j) {
      const V v = own[j];
      a += row[j] * v, b += row[k.width + j] * v, c += row[2 * k.width + j] * v,
          d += row[3 * k.width + j] * v;
    }
    x[k.rows[i]] -= a, x[k.rows[i + 1]] -= b, x[k.rows[i + 2]] -= c, x[k.rows[i + 3]] -= d;
  }
  for (; i < k.height; ++i, row += k.width) {
    V sum = {};
    for (int j = 0; j < k.width; ++j) sum += row[j] * own[j];
    x[k.rows[i]] -= sum;
  }
}

VOILE_INLINED void backward(const Node& k, Double4* x) {
  using V = Double4;
  V* own = x + k.first;
  const double* below = k.panel + (size_t)k.width * k.width;
  int j = 0;
  for (; j + 4 <= k.width; j += 4) {
    V a = own[j], b = own[j + 1], c = own[j + 2], d = own[j + 3];
    const double* row = below + j;
    for (int i = 0; i < k.height; ++i, row += k.width) {
      const V v = x[k.rows[i]];
      a -= row[0] * v, b -= row[1] * v, c -= row[2] * v, d -= row[3] * v;
    }
    own[j] = a, own[j + 1] = b, own[j + 2] = c, own[j + 3] = d;
  }
  for (; j < k.width; ++j) {
    V sum = own[j];
    for (int i = 0; i < k.height; ++i) sum -= below[(size_t)i * k.width + j] * x[k.rows[i]];
    own[j] = sum;
  }
  for (int i = k.width - 1; i >= 0; --i) {
    const double* row = k.panel + (size_t)i * k.width;
    own[i] = own[i] * row[i];
    for (int j = 0; j < i; ++j) own[j] -= row[j] * own[i];
  }
}

VOILE_CLONES void sweep(const Node* nodes, int count, Double4* x) {
  for (int s = 0; s < count; ++s) forward(nodes[s], x);
  for (int s = count - 1; s >= 0; --s) backward(nodes[s], x);
}

}  // namespace

Cholesky::Cholesky(int size, const int32_t* start, const int32_t* column, const double* value) {
  Definite made(std::make_shared<Fronts>(size, start, column, 1));
  if (!made.factor(value)) throw std::runtime_error("the matrix is not positive definite");
  const cholmod_factor& f = *made.by().made;
  const auto *super = static_cast<const int32_t*>(f.super), *at = static_cast<const int32_t*>(f.pi);
  const auto *places = static_cast<const int32_t*>(f.px), *index = static_cast<const int32_t*>(f.s);
  const auto* perm = static_cast<const int32_t*>(f.Perm);
  order.assign(perm, perm + size);
  struct Place {
    size_t row, panel;
  };
  std::vector<Place> starts;
  for (size_t s = 0; s < f.nsuper; ++s) {
    const int width = super[s + 1] - super[s], height = at[s + 1] - at[s];
    const double* from = made.panels() + places[s];  // by columns of `height`
    starts.push_back({rows.size(), panel.size()});
    for (int i = 0; i < height; ++i)
      for (int j = 0; j < width; ++j) {
        const double v = from[i + (size_t)j * height];
        panel.push_back((i == j ? 1.0 / v : i < j ? 0.0 : v));
      }
    rows.insert(rows.end(), index + at[s] + width, index + at[s + 1]);
  }
  work.resize((size_t)SIDES * size);
  for (size_t s = 0; s < f.nsuper; ++s) {
    const int width = super[s + 1] - super[s];
    nodes.push_back({super[s], width, at[s + 1] - at[s] - width, rows.data() + starts[s].row,
                     panel.data() + starts[s].panel});
  }
}

void Cholesky::solve(double* b, int count) {
  const int size = this->size();
  for (int i = 0; i < size; ++i)
    for (int k = 0; k < count; ++k) work[SIDES * i + k] = b[(size_t)k * size + order[i]];
  sweep(nodes.data(), (int)nodes.size(), fours(work.data()));
  for (int i = 0; i < size; ++i)
    for (int k = 0; k < count; ++k) b[(size_t)k * size + order[i]] = work[SIDES * i + k];
}

}  // namespace voile
