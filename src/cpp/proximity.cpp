#include "proximity.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

namespace voile {

static Vec at(const double* x, int vertex) {
  const double* p = x + 3 * (size_t)vertex;
  return {p[0], p[1], p[2]};
}

// ---- boxes ----

static constexpr double FAR = std::numeric_limits<double>::infinity();
static constexpr Box NOTHING{{FAR, FAR, FAR}, {-FAR, -FAR, -FAR}};

static Box both(const Box& a, const Box& b) {
  return {{std::min(a.low.x, b.low.x), std::min(a.low.y, b.low.y), std::min(a.low.z, b.low.z)},
          {std::max(a.high.x, b.high.x), std::max(a.high.y, b.high.y), std::max(a.high.z, b.high.z)}};
}

static bool meets(const Box& a, const Box& b) {
  return a.low.x <= b.high.x && b.low.x <= a.high.x && a.low.y <= b.high.y && b.low.y <= a.high.y &&
         a.low.z <= b.high.z && b.low.z <= a.high.z;
}

BoxTree::BoxTree(std::vector<int> vertex, int per, const double* x) : vertex_(std::move(vertex)), per_(per) {
  const int count = (int)(vertex_.size() / per);
  order_.resize(count);
  std::iota(order_.begin(), order_.end(), 0);
  std::vector<Vec> middle(count, Vec{0.0, 0.0, 0.0});
  for (int i = 0; i < count; ++i)
    for (int k = 0; k < per; ++k) middle[i] = middle[i] + at(x, corners(i)[k]);
  split(0, 0, count, middle);
  part_.resize(count);
  node_.resize(begin_.size());
}

void BoxTree::split(int node, int begin, int end, const std::vector<Vec>& middle) {
  if ((int)begin_.size() <= node) begin_.resize(node + 1, 0), end_.resize(node + 1, 0);
  begin_[node] = begin, end_[node] = end;
  if (leaf(node)) return;
  Box box = NOTHING;
  for (int i = begin; i < end; ++i) box = both(box, {middle[order_[i]], middle[order_[i]]});
  const Vec wide = box.high - box.low;
  double Vec::* const axis = wide.x >= wide.y && wide.x >= wide.z ? &Vec::x
                             : wide.y >= wide.z                   ? &Vec::y
                                                                  : &Vec::z;
  const int half = begin + (end - begin) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + half, order_.begin() + end,
                   [&](int i, int j) { return middle[i].*axis < middle[j].*axis; });
  split(2 * node + 1, begin, half, middle);
  split(2 * node + 2, half, end, middle);
}

void BoxTree::enclose(const double* x, const double* moved, double margin) {
  const Vec wider{margin, margin, margin};
  for (int i = 0; i < size(); ++i) {
    Box box = NOTHING;
    for (int k = 0; k < per_; ++k)
      for (const double* place : {x, moved}) {
        const Vec p = at(place, corners(order_[i])[k]);
        box = both(box, {p, p});
      }
    part_[i] = {box.low - wider, box.high + wider};
  }
  for (int node = (int)node_.size() - 1; node >= 0; --node) {
    if (!leaf(node)) {
      node_[node] = both(node_[2 * node + 1], node_[2 * node + 2]);
      continue;
    }
    node_[node] = NOTHING;
    for (int i = begin_[node]; i < end_[node]; ++i) node_[node] = both(node_[node], part_[i]);
  }
}

void BoxTree::meet(const BoxTree& a, int i, const BoxTree& b, int j, const Found& found) {
  if (!meets(a.node_[i], b.node_[j])) return;
  const bool same = &a == &b && i == j;
  if (a.leaf(i) && b.leaf(j)) {
    for (int k = a.begin_[i]; k < a.end_[i]; ++k)
      for (int l = same ? k + 1 : b.begin_[j]; l < b.end_[j]; ++l)
        if (meets(a.part_[k], b.part_[l])) found(a.order_[k], b.order_[l]);
  } else if (same) {
    meet(a, 2 * i + 1, b, 2 * i + 1, found);
    meet(a, 2 * i + 2, b, 2 * i + 2, found);
    meet(a, 2 * i + 1, b, 2 * i + 2, found);
  } else if (a.end_[i] - a.begin_[i] >= b.end_[j] - b.begin_[j]) {
    meet(a, 2 * i + 1, b, j, found);
    meet(a, 2 * i + 2, b, j, found);
  } else {
    meet(a, i, b, 2 * j + 1, found);
    meet(a, i, b, 2 * j + 2, found);
  }
}

// ---- squared distances ----

static double to_segment(Vec p, Vec a, Vec b) {
  const Vec edge = b - a;
  const double along = dot(p - a, edge) / std::max(dot(edge, edge), 1e-300);
  const Vec r = a + std::clamp(along, 0.0, 1.0) * edge - p;
  return dot(r, r);
}

static double to_triangle(Vec p, Vec a, Vec b, Vec c) {
  const Vec normal = cross(b - a, c - a), r = p - a;
  const double size = dot(normal, normal), u = dot(cross(r, c - a), normal), v = dot(cross(b - a, r), normal);
  if (size > 0.0 && u >= 0.0 && v >= 0.0 && u + v <= size) return dot(r, normal) * dot(r, normal) / size;
  return std::min({to_segment(p, a, b), to_segment(p, b, c), to_segment(p, c, a)});
}

static double of_segments(Vec a, Vec b, Vec c, Vec d) {
  const Vec normal = cross(b - a, d - c), r = c - a;
  const double size = dot(normal, normal), s = dot(cross(r, d - c), normal), t = dot(cross(r, b - a), normal);
  if (size > 0.0 && s >= 0.0 && s <= size && t >= 0.0 && t <= size)
    return dot(r, normal) * dot(r, normal) / size;
  return std::min({to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)});
}

// ---- pairs ----

static std::vector<int> all(size_t count) {
  std::vector<int> places(count);
  std::iota(places.begin(), places.end(), 0);
  return places;
}

Proximity::Proximity(std::span<const double> x, std::vector<int> triangles, std::vector<int> edges)
    : count_((int)(x.size() / 3)),
      points_(all(x.size() / 3), 1, x.data()),
      triangles_(std::move(triangles), 3, x.data()),
      edges_(std::move(edges), 2, x.data()) {}

void Proximity::pairs(const double* x, const double* moved, double reach, std::vector<int64_t>& faces,
                      std::vector<int64_t>& edges) {
  for (BoxTree* tree : {&points_, &triangles_, &edges_}) tree->enclose(x, moved, 0.5 * reach);
  auto way = [&](int vertex) { return at(moved, vertex) - at(x, vertex); };
  // Whether parts with na and nb vertices a and b may get as near as that, by the square of their distance.
  auto nears = [&](double squared, const int* a, int na, const int* b, int nb) {
    double far = 0.0;
    for (int i = 0; i < na; ++i)
      for (int j = 0; j < nb; ++j) far = std::max(far, length(way(a[i]) - way(b[j])));
    const double most = reach + far;
    return squared <= most * most * (1.0 + 1e-9);  // round-off of a distance is none
  };
  faces.clear(), edges.clear();
  BoxTree::meet(points_, triangles_, [&](int v, int t) {
    const int* c = triangles_.corners(t);
    if (c[0] == v || c[1] == v || c[2] == v) return;
    const double squared = to_triangle(at(x, v), at(x, c[0]), at(x, c[1]), at(x, c[2]));
    if (nears(squared, &v, 1, c, 3)) faces.push_back((int64_t)t * count_ + v);
  });
  BoxTree::meet(edges_, edges_, [&](int i, int j) {
    const int *a = edges_.corners(i), *b = edges_.corners(j);
    if (a[0] == b[0] || a[0] == b[1] || a[1] == b[0] || a[1] == b[1]) return;
    const double squared = of_segments(at(x, a[0]), at(x, a[1]), at(x, b[0]), at(x, b[1]));
    if (nears(squared, a, 2, b, 2)) edges.push_back((int64_t)std::min(i, j) * edges_.size() + std::max(i, j));
  });
  std::sort(faces.begin(), faces.end());
  std::sort(edges.begin(), edges.end());
}

}  // namespace voile
