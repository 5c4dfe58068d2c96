#include "coarsen.hpp"

#include <queue>

#include "coarsen_surface.hpp"

namespace voile {

namespace {

constexpr double NEVER = std::numeric_limits<double>::infinity();
constexpr double FOLD = 0.7;   // cosine of 45 degrees: no triangle turns more in one move
constexpr double DEEP = 0.25;  // of the coarse edge: largest loss of shape, of surfaces and of lines
constexpr double STEPS = 0.5;  // the same for stepped borders of supports and fabrics, which are smoothed
constexpr double LOST = 4.0;   // price of the largest loss of shape, in coarse edges squared
constexpr double POOR = 0.3;   // quality (12 degrees) that no triangle falls below unless one was worse

// Chooses the moves.
class Coarsener {
 public:
  Coarsener(const FineMesh& mesh, int target);
  CoarseMesh run();

 private:
  const FineMesh& mesh_;
  Surface surface_;
  int target_;
  double size_[2];                         // coarse edges in the two shapes (m)
  std::vector<std::vector<int>> members_;  // (n) vertices of the group that a vertex is the smallest of
  std::vector<Quadric> loss_[2], line_loss_[2];

  struct Entry {
    double cost;
    int group;
    bool operator<(const Entry& o) const { return cost != o.cost ? cost > o.cost : group > o.group; }
  };
  std::priority_queue<Entry> queue_;
  std::vector<char> queued_;  // groups

  void measure();
  void push(double cost, int group);
  void push_around(const std::vector<Move>& moved);
  double cost(int group, std::vector<Move>& best) const;
  bool together(int group, int v, std::vector<Move>& found) const;
  double price(Move move) const;
  void collapse(Move move);
};

Coarsener::Coarsener(const FineMesh& mesh, int target)
    : mesh_(mesh), surface_(mesh), target_(target), members_(mesh.vertices()), queued_(mesh.vertices(), 0) {
  for (int v = 0; v < mesh.vertices(); ++v) members_[mesh.group[v]].push_back(v);
  measure();
}

void Coarsener::measure() {
  for (int shape = surface_.first_shape; shape < 2; ++shape) {
    const std::vector<int>& corner = surface_.corner[shape];
    size_t count = (shape ? mesh_.rest : mesh_.start).size() / 3;
    loss_[shape].resize(count), line_loss_[shape].resize(count);
    double area = 0.0;
    for (int t = 0; t < mesh_.triangles(); ++t) {
      Vec normal = surface_.facet(shape, t).normal;
      area += 0.5 * length(normal);
      for (int k = 0; k < 3; ++k) {
        loss_[shape][corner[3 * t + k]].add_plane(normal, surface_.at(shape, t, k));
        int i = 3 * t + (k + 1) % 3, j = 3 * t + (k + 2) % 3;
        if (!surface_.line(surface_.corner[0][i], surface_.corner[0][j])) continue;
        Vec from = surface_.point(shape, corner[i]), to = surface_.point(shape, corner[j]);
        for (int end : {i, j}) line_loss_[shape][corner[end]].add_line(from, to);
      }
    }
    size_[shape] = std::sqrt(2.0 * area / (std::sqrt(3.0) * std::max(target_, 1)));
  }
}

CoarseMesh Coarsener::run() {
  std::vector<Move> best;
  for (int v = 0; v < mesh_.vertices(); ++v) push(cost(v, best), v);
  while (surface_.left > target_ && !queue_.empty()) {
    Entry entry = queue_.top();
    queue_.pop();
    queued_[entry.group] = 0;
    double now = cost(entry.group, best);
    if (now > entry.cost) {  // its surroundings have changed
      push(now, entry.group);
      continue;
    }
    std::vector<Move> moved = best;
    for (Move move : moved) collapse(move);
    for (Move move : moved) surface_.flip_around(move.to);
    push_around(moved);
  }
  surface_.flip_all();
  return surface_.result();
}

void Coarsener::push(double cost, int group) {
  if (cost == NEVER) return;
  queue_.push({cost, group});
  queued_[group] = 1;
}

// Groups that could not move may be able to now; those in the queue are looked at again when their turn
// comes.
void Coarsener::push_around(const std::vector<Move>& moved) {
  std::vector<Move> best;
  for (Move move : moved)
    for (int t : surface_.around[move.to])
      for (int k = 0; k < 3; ++k) {
        int group = mesh_.group[surface_.corner[0][3 * t + k]];
        if (!queued_[group]) push(cost(group, best), group);
      }
}

// Cheapest move of a group of sewn vertices and its cost.
double Coarsener::cost(int group, std::vector<Move>& best) const {
  const std::vector<int>& all = members_[group];
  auto stays = [&](int u) {
    size_t on = surface_.lines[u].size();
    return surface_.gone[u] || mesh_.locked[u] || (on != 2 && (on || all.size() > 1));
  };
  if (all.empty() || std::any_of(all.begin(), all.end(), stays)) return NEVER;
  std::vector<int> targets;
  for (const Line& l : surface_.lines[all[0]]) targets.push_back(l.other);
  if (targets.empty())
    for (int t : surface_.around[all[0]])  // around an inner vertex every neighbour comes next once
      targets.push_back(surface_.corner[0][3 * t + (surface_.find(t, all[0]) + 1) % 3]);
  double least = NEVER;
  std::vector<Move> found;
  for (int v : targets) {
    if (!together(group, v, found)) continue;
    double worst = 0.0;
    for (Move move : found)
      if (worst < least) worst = std::max(worst, surface_.allows(move) ? price(move) : NEVER);
    if (worst < least) least = worst, best = found;
  }
  return least;
}

// What all vertices of a group do where the first one moves to v: each along its own border to one sewn to v.
bool Coarsener::together(int group, int v, std::vector<Move>& found) const {
  const std::vector<int>& all = members_[group];
  found.clear();
  found.push_back({all[0], v});
  for (size_t i = 1; i < all.size(); ++i) {
    int to = -1;
    for (const Line& l : surface_.lines[all[i]])
      if (mesh_.group[l.other] == mesh_.group[v]) {
        if (to >= 0) return false;
        to = l.other;
      }
    if (to < 0) return false;
    for (Move move : found) {  // apart from one another, so that each may be checked alone
      if (move.to == to) return false;
      for (int t : surface_.around[all[i]])
        if (surface_.find(t, move.to) >= 0 || surface_.find(t, move.from) >= 0) return false;
      for (int t : surface_.around[move.from])
        if (surface_.find(t, to) >= 0) return false;
    }
    found.push_back({all[i], to});
  }
  return true;
}

// What a move costs: the longest new edge squared, in coarse edges, over the worst quality, and the loss of
// shape.
double Coarsener::price(Move move) const {
  auto [u, v] = move;
  double longest = 0.0, quality = 1.0, before = 1.0, lost = 0.0;
  bool on_line = surface_.lines[u].size();
  double bound = on_line && surface_.lines[u][0].kind & (BORDER | CUT | CLAMP) ? DEEP : STEPS;
  for (int shape = surface_.first_shape; shape < 2; ++shape) {
    double unit = size_[shape] * size_[shape];
    const std::vector<int>& corner = surface_.corner[shape];
    for (int t : surface_.around[u]) {
      int k = surface_.find(t, u), kv = surface_.find(t, v), from = corner[3 * t + k];
      Facet old = surface_.facet(shape, t);
      before = std::min(before, old.quality());
      if (kv >= 0) {
        Vec to = surface_.at(shape, t, kv);
        lost = std::max(lost, loss_[shape][from].at(to) / (unit * DEEP * DEEP));
        if (on_line) lost = std::max(lost, line_loss_[shape][from].at(to) / (unit * bound * bound));
        continue;
      }
      int to = v;
      if (shape) to = surface_.rest_after(move, from);
      Facet now(surface_.point(shape, to), surface_.at(shape, t, (k + 1) % 3),
                surface_.at(shape, t, (k + 2) % 3));
      if (now.cosine(old) < FOLD) return NEVER;
      quality = std::min(quality, now.quality());
      longest = std::max(longest, now.longest / unit);
    }
  }
  if (lost > 1.0 || (quality < POOR && quality < before)) return NEVER;
  return longest / quality + LOST * lost;
}

void Coarsener::collapse(Move move) {
  auto merge = [&](int shape, int old, int now) {
    loss_[shape][now].add(loss_[shape][old]);
    line_loss_[shape][now].add(line_loss_[shape][old]);
  };
  for (auto [old, now] : surface_.collapse(move)) merge(1, old, now);
  if (surface_.first_shape == 0) merge(0, move.from, move.to);
}

}  // namespace

CoarseMesh coarsen(const FineMesh& mesh, int target) { return Coarsener(mesh, target).run(); }

}  // namespace voile
