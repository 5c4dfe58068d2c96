#include "block_lu.hpp"

#include <amd.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "blas.hpp"

namespace voile {

namespace {

const int ONE = 1;
const double PLUS = 1.0, MINUS = -1.0;
// A child joins its parent's front if the zeros stored for it are below this share of the joint front.
constexpr double ZEROS = 0.25;

// Block rows in elimination order.
std::vector<int> minimum_degree(int n, std::span<const int> start, std::span<const int> column) {
  std::vector<int> order(n);
  double control[AMD_CONTROL];
  amd_defaults(control);
  if (amd_order(n, start.data(), column.data(), order.data(), control, nullptr) < AMD_OK)
    throw std::runtime_error("the block pattern is malformed");
  return order;
}

}  // namespace

BlockLU::BlockLU(int n, std::span<const int> start, std::span<const int> column) : place_(n, -1) {
  analyse(start, column);
}

void BlockLU::analyse(std::span<const int> start, std::span<const int> column) {
  const int n = (int)place_.size();
  const std::vector<int> order = minimum_degree(n, start, column);
  std::vector<int> step(n), mark(n, -1);
  for (int k = 0; k < n; ++k) step[order[k]] = k;
  // Entries by the step that eliminates the first of their row and column.
  std::vector<std::vector<Entry>> entries(n);
  for (int i = 0; i < n; ++i)
    for (int e = start[i]; e < start[i + 1]; ++e)
      entries[std::min(step[i], step[column[e]])].push_back({e, i, column[e]});
  std::vector<std::vector<int>> waiting(n);  // per step: fronts whose parent is that step's
  std::vector<Front> all;
  std::vector<int> zeros;  // per front: block entries stored for the sake of its size only
  for (int k = 0; k < n; ++k) {
    const int own = order[k];
    Front front{.pivot = {own}, .entries = std::move(entries[k])};
    auto couple = [&](int i) {
      if (step[i] > k && mark[i] != k) {
        mark[i] = k;
        front.rest.push_back(i);
      }
    };
    for (const Entry& e : front.entries) couple(e.row), couple(e.column);
    for (int c : waiting[k]) std::ranges::for_each(all[c].rest, couple);
    int empty = 0;
    // Rows of a child that joins are stored as long as the front's.
    for (int c : waiting[k]) {
      Front& child = all[c];
      const int total = (int)(front.pivot.size() + front.rest.size() + child.pivot.size());
      const int more =
          zeros[c] + 2 * (int)child.pivot.size() * (total - (int)child.pivot.size() - (int)child.rest.size());
      if (empty + more > ZEROS * total * total) {
        front.children.push_back(c);
        continue;
      }
      empty += more;
      front.pivot.insert(front.pivot.begin(), child.pivot.begin(), child.pivot.end());
      front.entries.insert(front.entries.end(), child.entries.begin(), child.entries.end());
      front.children.insert(front.children.end(), child.children.begin(), child.children.end());
      child = Front{};
    }
    int next = n;
    for (int i : front.rest) next = std::min(next, step[i]);
    if (next < n) waiting[next].push_back((int)all.size());
    zeros.push_back(empty);
    all.push_back(std::move(front));
  }
  std::vector<int> number(all.size(), -1);  // without those that joined others
  for (size_t s = 0; s < all.size(); ++s) {
    if (all[s].pivot.empty()) continue;
    number[s] = (int)fronts_.size();
    for (int& c : all[s].children) c = number[c];
    fronts_.push_back(std::move(all[s]));
  }
}

bool BlockLU::factor(std::span<const double> blocks, std::span<const char> active) {
  for (Front& f : fronts_) {
    f.rows.clear();
    for (int i : f.pivot)
      if (active[i]) f.rows.push_back(i);
    f.pivots = 3 * (int)f.rows.size();
    for (int i : f.rest)
      if (active[i]) f.rows.push_back(i);
    f.size = 3 * (int)f.rows.size();
    f.value.assign((size_t)f.size * f.size, 0.0);
    for (size_t k = 0; k < f.rows.size(); ++k) place_[f.rows[k]] = 3 * (int)k;
    for (const Entry& e : f.entries) {
      if (!active[e.row] || !active[e.column]) continue;
      double* to = &f.value[place_[e.row] + (size_t)place_[e.column] * f.size];
      for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) to[a + (size_t)b * f.size] += blocks[9 * e.block + 3 * a + b];
    }
    for (int c : f.children) {
      const Front& child = fronts_[c];
      const int first = child.pivots / 3, last = child.size / 3;
      for (int b = first; b < last; ++b)
        for (int k = 0; k < 3; ++k) {
          const double* from = &child.value[(size_t)(3 * b + k) * child.size];
          double* to = &f.value[(size_t)(place_[child.rows[b]] + k) * f.size];
          for (int a = first; a < last; ++a)
            for (int l = 0; l < 3; ++l) to[place_[child.rows[a]] + l] += from[3 * a + l];
        }
    }
    if (!eliminate(f)) return false;
  }
  return true;
}

bool BlockLU::eliminate(Front& f) {
  const int p = f.pivots, rest = f.size - p, size = f.size;
  if (p == 0) return true;
  f.swaps.resize(p);
  int info = 0;
  double* value = f.value.data();
  dgetrf_(&p, &p, value, &size, f.swaps.data(), &info);
  if (info != 0 || !std::isfinite(value[(size_t)(p - 1) * (size + 1)])) return false;
  if (rest == 0) return true;
  double *right = value + (size_t)p * size, *below = value + p;
  dlaswp_(&rest, right, &size, &ONE, &p, f.swaps.data(), &ONE);
  dtrsm_("L", "L", "N", "U", &p, &rest, &PLUS, value, &size, right, &size);
  dtrsm_("R", "U", "N", "N", &rest, &p, &PLUS, value, &size, below, &size);
  dgemm_("N", "N", &rest, &rest, &p, &MINUS, below, &size, right, &size, &PLUS, right + p, &size);
  return true;
}

void BlockLU::solve(std::span<double> x) const {
  auto gather = [&](const Front& f) {
    work_.resize(f.size);
    for (size_t k = 0; k < f.rows.size(); ++k) std::copy_n(&x[3 * f.rows[k]], 3, &work_[3 * k]);
  };
  auto scatter = [&](const Front& f) {
    for (size_t k = 0; k < f.rows.size(); ++k) std::copy_n(&work_[3 * k], 3, &x[3 * f.rows[k]]);
  };
  for (const Front& f : fronts_) {
    if (f.pivots == 0) continue;
    const int p = f.pivots, rest = f.size - p;
    gather(f);
    dlaswp_(&ONE, work_.data(), &f.size, &ONE, &p, f.swaps.data(), &ONE);
    dtrsv_("L", "N", "U", &p, f.value.data(), &f.size, work_.data(), &ONE);
    if (rest)
      dgemv_("N", &rest, &p, &MINUS, &f.value[p], &f.size, work_.data(), &ONE, &PLUS, &work_[p], &ONE);
    scatter(f);
  }
  for (auto f = fronts_.rbegin(); f != fronts_.rend(); ++f) {
    if (f->pivots == 0) continue;
    const int p = f->pivots, rest = f->size - p;
    gather(*f);
    if (rest)
      dgemv_("N", &p, &rest, &MINUS, &f->value[(size_t)p * f->size], &f->size, &work_[p], &ONE, &PLUS,
             work_.data(), &ONE);
    dtrsv_("U", "N", "N", &p, f->value.data(), &f->size, work_.data(), &ONE);
    scatter(*f);
  }
}

}  // namespace voile
