#include "coarsen_surface.hpp"

namespace voile {

namespace {

constexpr double FLIP_FOLD = 0.87;  // cosine of 30 degrees: no triangle turns more where an edge is flipped
constexpr double BETTER = 1.02;     // gain of quality for which an edge is flipped
constexpr double OUTSIDE = 0.3;     // coordinate beyond a border up to which a vertex is extrapolated
constexpr int FLIP_ROUNDS = 4;

}  // namespace

Surface::Surface(const FineMesh& fine)
    : mesh(fine),
      around(fine.vertices()),
      lines(fine.vertices()),
      gone(fine.vertices(), 0),
      left(fine.vertices()),
      inside_(fine.triangles()),
      alive_(fine.triangles(), 1),
      place_(fine.vertices(), -1),
      chart_of_(fine.vertices(), -1),
      hang_(fine.hang.begin(), fine.hang.end()),
      hang_weight_(fine.hang_weight.begin(), fine.hang_weight.end()),
      hosts_(fine.vertices()),
      hangs_(fine.vertices()),
      in_group_(fine.vertices(), 0),
      mark_(fine.vertices(), 0) {
  corner[0].assign(fine.corner.begin(), fine.corner.end());
  corner[1].assign(fine.rest_corner.begin(), fine.rest_corner.end());
  first_shape = corner[0] == corner[1] &&
                std::equal(fine.start.begin(), fine.start.end(), fine.rest.begin(), fine.rest.end());
  for (int shape : {0, 1})
    if (fine.triangles()) origin_[shape] = at(shape, 0, 0);  // near the surface, for the digits of its shape
  for (int group : fine.group) in_group_[group]++;
  for (size_t k = 0; k < corner[0].size(); ++k) around[corner[0][k]].push_back((int)(k / 3));
  for (size_t f = 0; f < fine.kind.size(); ++f) {
    int a = fine.feature[2 * f], b = fine.feature[2 * f + 1];
    lines[a].push_back({b, fine.kind[f]});
    lines[b].push_back({a, fine.kind[f]});
  }
  for (size_t k = 0; k < hang_weight_.size(); ++k) {
    hangs_[hang_[3 * k]].push_back((int)k);
    for (int end : {1, 2}) hosts_[hang_[3 * k + end]].push_back((int)k);
  }
}

// Whether supports, lines, seams and the surface allow a move, whatever its shape.
bool Surface::allows(Move move) const {
  auto [u, v] = move;
  if (mesh.support[u] && mesh.support[u] != mesh.support[v]) return false;
  return (lines[u].empty() || (follows_line(move) && follows_seams(move))) && stays_surface(move);
}

// Whether a vertex on a feature line may move along it: the line is of one kind there and no ring of two.
bool Surface::follows_line(Move move) const {
  auto [u, v] = move;
  int b = next(move);
  return lines[u][0].kind == lines[u][1].kind && !line(b, v) && mesh.group[b] != mesh.group[v];
}

// Whether what is sewn to the border at u can stay sewn to it, and what u is sewn to is sewn to something
// else.
bool Surface::follows_seams(Move move) const {
  auto [u, v] = move;
  int b = next(move);
  for (int k : hosts_[u]) {
    const int* record = &hang_[3 * k];
    if (record[0] < 0) continue;
    int other = record[1] == u ? record[2] : record[1], group = mesh.group[record[0]];
    if ((other != v && other != b) || group == mesh.group[v] || group == mesh.group[b]) return false;
  }
  for (int k : hangs_[u])
    if (hang_[3 * k] >= 0 && !(sewn_beside(hang_[3 * k + 1], k) && sewn_beside(hang_[3 * k + 2], k)))
      return false;
  return true;
}

// Whether a vertex is sewn to others by more than one record.
bool Surface::sewn_beside(int vertex, int record) const {
  if (in_group_[mesh.group[vertex]] > 1) return true;
  for (int k : hangs_[vertex])
    if (hang_[3 * k] >= 0) return true;
  for (int k : hosts_[vertex])
    if (k != record && hang_[3 * k] >= 0 && (hang_[3 * k + 1] == vertex || hang_[3 * k + 2] == vertex))
      return true;
  return false;
}

// Whether the mesh stays a surface: the link condition, nothing left without a triangle, no two sewn to one
// another in one triangle, the rest shape defined.
bool Surface::stays_surface(Move move) const {
  auto [u, v] = move;
  int dying = 0, ends = ++stamp_;
  for (int t : around[u]) {
    int k = find(t, v);
    if (k < 0) continue;
    dying++;
    int opposite = corner[0][3 * t + 3 - k - find(t, u)];
    if (around[opposite].size() < 2) return false;
    mark_[opposite] = ends;
    bool goes_on = false;  // the rest shape on this side
    for (int s : around[u]) goes_on |= s != t && find(s, v) < 0 && rest_of(s, u) == rest_of(t, u);
    if (!goes_on) return false;
  }
  if (!dying) return false;
  for (int s : around[u]) {
    if (find(s, v) >= 0) continue;
    int k = find(s, u), a = corner[0][3 * s + (k + 1) % 3], b = corner[0][3 * s + (k + 2) % 3];
    int group = mesh.group[v];
    if (mesh.group[a] == group || mesh.group[b] == group) return false;
    if (rest_after(move, rest_of(s, u)) < 0) return false;
    if (mark_[a] == ends && mark_[b] == ends)
      for (int t : around[v])
        if (find(t, a) >= 0 && find(t, b) >= 0) return false;
  }
  // link condition: u and v have no neighbours in common but those across their edge
  int common = 0, near = ++stamp_;
  for (int t : around[u])
    for (int k = 0; k < 3; ++k) mark_[corner[0][3 * t + k]] = near;
  mark_[u] = mark_[v] = 0;
  for (int t : around[v])
    for (int k = 0; k < 3; ++k) {
      int w = corner[0][3 * t + k];
      if (mark_[w] == near) common++, mark_[w] = 0;
    }
  return common == dying;
}

// Removes move.from: its triangles go on with move.to, or vanish; what they held finds its place in the
// others. Returns rest vertices that are gone with those in their place.
Pairs Surface::collapse(Move move) {
  auto [u, v] = move;
  std::vector<int> points{u}, stay;
  Pairs rest;
  for (int t : around[u]) {
    points.insert(points.end(), inside_[t].begin(), inside_[t].end());
    inside_[t].clear();
    if (find(t, v) < 0) {
      stay.push_back(t);
      continue;
    }
    if (rest.empty()) place_[u] = rest_of(t, u), chart_of_[u] = mesh.chart[t];
    std::pair<int, int> pair{rest_of(t, u), rest_of(t, v)};
    if (std::find(rest.begin(), rest.end(), pair) == rest.end()) rest.push_back(pair);
    alive_[t] = 0;
    for (int k = 0; k < 3; ++k)
      if (int w = corner[0][3 * t + k]; w != u) std::erase(around[w], t);
  }
  if (lines[u].size()) slide_seams(move);
  for (int t : stay) {
    int k = find(t, u);
    corner[0][3 * t + k] = v;
    int& at_rest = corner[1][3 * t + k];
    at_rest =
        std::find_if(rest.begin(), rest.end(), [&](auto pair) { return pair.first == at_rest; })->second;
    around[v].push_back(t);
  }
  around[u].clear();
  if (lines[u].size()) {
    int b = next(move), kind = lines[u][0].kind;
    for (Line& l : lines[v])
      if (l.other == u) l = {b, kind};
    for (Line& l : lines[b])
      if (l.other == u) l = {v, kind};
  }
  gone[u] = 1;
  left--;
  relocate(points, stay);
  return rest;
}

// What is sewn to the border's edges at u is sewn to the one that is left, at the same length along it at
// rest.
void Surface::slide_seams(Move move) {
  auto [u, v] = move;
  for (int k : hangs_[u]) hang_[3 * k] = -1;
  if (hosts_[u].empty()) return;
  int b = next(move);
  double to[2] = {0.0, 0.0};  // length at rest to v, to b
  for (int t : around[u])
    for (int side : {0, 1})
      if (int w = side ? b : v; find(t, w) >= 0)
        to[side] = length(point(1, rest_of(t, u)) - point(1, rest_of(t, w)));
  double share = to[0] / (to[0] + to[1]);
  for (int k : hosts_[u]) {
    int* record = &hang_[3 * k];
    if (record[0] < 0) continue;
    bool swap = record[1] == u;
    int other = swap ? record[2] : record[1];
    double from_u = swap ? hang_weight_[k] : 1.0 - hang_weight_[k];
    record[1] = v, record[2] = b;
    hang_weight_[k] = other == b ? share + from_u * (1.0 - share) : share * (1.0 - from_u);
    hosts_[other == b ? v : b].push_back(k);
  }
}

// Finds fine vertices in some triangles: the nearest in the rest shape.
void Surface::relocate(const std::vector<int>& points, const std::vector<int>& triangles) {
  for (int p : points) {
    Vec x = point(1, place_[p]);
    double best = std::numeric_limits<double>::infinity();
    int home = -1;
    for (int t : triangles) {
      if (mesh.chart[t] != chart_of_[p]) continue;
      Vec a = at(1, t, 0), b = at(1, t, 1), c = at(1, t, 2);
      std::array<double, 3> w = nearest(x, a, b, c);
      Vec off = x - (w[0] * a + w[1] * b + w[2] * c);
      if (dot(off, off) < best) best = dot(off, off), home = t;
    }
    inside_[home].push_back(p);
  }
}

// Flips the edge opposite corner k of triangle t where the worse of the two triangles gets better by it.
bool Surface::flip(int t, int k) {
  int c = corner[0][3 * t + k], a = corner[0][3 * t + (k + 1) % 3], b = corner[0][3 * t + (k + 2) % 3];
  if (line(a, b)) return false;
  int s = -1;
  for (int other : around[a])
    if (other != t && find(other, b) >= 0) s = other;
  if (s < 0) return false;
  int d = corner[0][3 * s + 3 - find(s, a) - find(s, b)];
  if (c == d || mesh.group[c] == mesh.group[d]) return false;
  for (int other : around[c])
    if (find(other, d) >= 0) return false;
  int now[2][2][3];  // shape, triangle, corner: a d c and d b c
  double before = 1.0, after = 1.0;
  for (int shape : {0, 1}) {
    auto of = [&](int triangle, int vertex) { return corner[shape][3 * triangle + find(triangle, vertex)]; };
    int ia = of(t, a), ib = of(t, b), ic = of(t, c), id = of(s, d);
    int corners[2][3] = {{ia, id, ic}, {id, ib, ic}};
    std::copy(&corners[0][0], &corners[0][0] + 6, &now[shape][0][0]);
    if (shape < first_shape) continue;
    Facet old[] = {facet(shape, t), facet(shape, s)};
    for (const auto& triangle : corners) {
      Facet fresh(point(shape, triangle[0]), point(shape, triangle[1]), point(shape, triangle[2]));
      if (fresh.cosine(old[0]) < FLIP_FOLD || fresh.cosine(old[1]) < FLIP_FOLD) return false;
      after = std::min(after, fresh.quality());
    }
    for (const Facet& facet : old) before = std::min(before, facet.quality());
  }
  if (after < BETTER * before) return false;
  for (int shape : {0, 1}) {
    std::copy(now[shape][0], now[shape][0] + 3, &corner[shape][3 * t]);
    std::copy(now[shape][1], now[shape][1] + 3, &corner[shape][3 * s]);
  }
  std::erase(around[b], t), std::erase(around[a], s);
  around[d].push_back(t), around[c].push_back(s);
  std::vector<int> points = inside_[t];
  points.insert(points.end(), inside_[s].begin(), inside_[s].end());
  inside_[t].clear(), inside_[s].clear();
  relocate(points, {t, s});
  return true;
}

void Surface::flip_around(int vertex) {
  for (int t : std::vector<int>(around[vertex]))
    for (int k = 0; k < 3; ++k) flip(t, k);
}

void Surface::flip_all() {
  bool any = true;
  for (int round = 0; any && round < FLIP_ROUNDS; ++round) {
    any = false;
    for (int t = 0; t < mesh.triangles(); ++t)
      for (int k = 0; alive_[t] && k < 3; ++k) any |= flip(t, k);
  }
}

CoarseMesh Surface::result() const {
  CoarseMesh out;
  out.home.assign(mesh.vertices(), -1);
  out.weight.assign(3 * (size_t)mesh.vertices(), 0.0);
  auto locate = [&](int vertex, std::array<double, 3> w) {
    out.home[vertex] = (int)out.triangle.size();
    std::copy(w.begin(), w.end(), &out.weight[3 * (size_t)vertex]);
  };
  for (int t = 0; t < mesh.triangles(); ++t) {
    if (!alive_[t]) continue;
    for (int k = 0; k < 3; ++k) {
      std::array<double, 3> one{};
      one[k] = 1.0;
      locate(corner[0][3 * t + k], one);
    }
    for (int p : inside_[t]) {
      Vec x = point(1, place_[p]), a = at(1, t, 0), b = at(1, t, 1), c = at(1, t, 2);
      std::array<double, 3> w = barycentric(x, a, b, c);
      locate(p, *std::min_element(w.begin(), w.end()) < -OUTSIDE ? nearest(x, a, b, c) : w);
    }
    out.triangle.push_back(t);
    for (int k = 0; k < 3; ++k) {
      out.corner.push_back(corner[0][3 * t + k]);
      out.rest_corner.push_back(corner[1][3 * t + k]);
    }
  }
  for (int a = 0; a < mesh.vertices(); ++a)
    for (const Line& l : lines[a])
      if (!gone[a] && a < l.other) {
        out.feature.insert(out.feature.end(), {a, l.other});
        out.kind.push_back(l.kind);
      }
  for (size_t k = 0; k < hang_weight_.size(); ++k) {
    if (hang_[3 * k] < 0) continue;
    out.hang.insert(out.hang.end(), &hang_[3 * k], &hang_[3 * k] + 3);
    out.hang_weight.push_back(hang_weight_[k]);
  }
  return out;
}

}  // namespace voile
