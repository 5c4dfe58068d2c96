#include "fronts.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

namespace voile {
namespace {

// Operations of a factor from which METIS' ordering is tried, too. It takes as long as 3 to 4 factors, and
// saves 2 per cent at 4e7 (2,560 unknowns), 30 at 3e9 (31,700).
constexpr double LARGE = 1e8;
// Operations from which a second thread is started, which takes some 0.2 ms: 5 ms of one. Subtrees cut off
// for each. What a thread is worth in a front that threads share.
constexpr double WORTH = 1e8;
constexpr int CUTS = 16;
constexpr double SHARED = 0.8;

}  // namespace

Fronts::Fronts(int size, const int32_t* start, const int32_t* column, int most)
    : given(start[size]), threads(most) {
  cholmod_start(&common);
  common.print = 0;
  common.nmethods = 1;
  common.method[0].ordering = CHOLMOD_AMD;
  common.method[1].ordering = CHOLMOD_METIS;
  common.supernodal = CHOLMOD_SUPERNODAL;
  cholmod_sparse a{};
  a.nrow = a.ncol = size;
  a.nzmax = given;
  a.p = const_cast<int32_t*>(start);
  a.i = const_cast<int32_t*>(column);
  a.stype = 1;  // one triangle is read
  a.itype = CHOLMOD_INT;
  a.xtype = CHOLMOD_PATTERN;
  a.dtype = CHOLMOD_DOUBLE;
  a.sorted = a.packed = 1;
  made = cholmod_analyze(&a, &common);
  if (made && common.fl > LARGE) {
    cholmod_free_factor(&made, &common);
    common.nmethods = 2;  // the better of both
    made = cholmod_analyze(&a, &common);
  }
  if (!made) throw std::runtime_error("CHOLMOD failed with status " + std::to_string(common.status));

  const auto *super = static_cast<const int32_t*>(made->super), *at = static_cast<const int32_t*>(made->pi);
  const auto *panel = static_cast<const int32_t*>(made->px), *row = static_cast<const int32_t*>(made->s);
  const int count = (int)made->nsuper;
  std::vector<int32_t> front(size);  // of each column
  for (int k = 0; k < count; ++k) {
    const int width = super[k + 1] - super[k], height = at[k + 1] - at[k];
    all.push_back({super[k], width, height, row + at[k], (size_t)panel[k], across});
    across += (size_t)(height - width) * width;
    std::fill(front.begin() + super[k], front.begin() + super[k + 1], k);
  }
  for (int k = 0; k < count; ++k) {
    Front& f = all[k];
    if (!f.below()) continue;
    f.parent = front[f.rows[f.width]];
    f.into = place.size();
    const int32_t *theirs = all[f.parent].rows, *p = theirs;
    for (int i = f.width; i < f.height; ++i) {
      while (*p < f.rows[i]) ++p;
      place.push_back((int32_t)(p - theirs));
    }
    f.sibling = std::exchange(all[f.parent].child, k);
  }
  share();
  stacks.resize(lanes.size());
  sums.resize(all.size());
  late.resize(all.size());
  line_up();
  take(start, column);
}

// Places the entries.
void Fronts::take(const int32_t* start, const int32_t* column) {
  const int n = size();
  std::vector<int32_t> rank(n), row(n),
      found(n, -1);  // of each row: in the order; in a front; in a column's pairs
  for (int i = 0; i < n; ++i) rank[order()[i]] = i;
  const auto each = [&](int i, const auto& visit) {
    for (int e = start[order()[i]]; e < start[order()[i] + 1]; ++e) visit(e, rank[column[e]]);
  };
  begin.assign(n + 1, 0);
  for (int i = 0; i < n; ++i) each(i, [&](int, int j) { begin[j + 1] += j <= i; });
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  entries.resize(begin[n]);
  std::vector<int32_t> end(begin.begin(), begin.end() - 1);
  for (int i = 0; i < n; ++i)
    each(i, [&](int e, int j) {
      if (j <= i) entries[end[j]++] = {e, -1, i};
    });
  bool symmetric = true;
  for (const Front& f : all) {
    for (int i = 0; i < f.height; ++i) row[f.rows[i]] = i;
    for (int j = f.first; j < f.first + f.width; ++j) {
      for (int k = begin[j]; k < begin[j + 1]; ++k) found[entries[k].row] = k;
      each(j, [&](int e, int i) {
        if (i < j) return;
        if (found[i] < begin[j])
          symmetric = false;
        else
          entries[found[i]].upper = e;
      });
      for (int k = begin[j]; k < begin[j + 1]; ++k) {
        symmetric = symmetric && entries[k].upper >= 0;
        entries[k].row = row[entries[k].row];
      }
    }
  }
  if (!symmetric) throw std::runtime_error("the pattern of a matrix is not symmetric");
}

// Subtrees in lanes of about the same work, the fronts above them last: of all ways to cut off the heaviest
// subtree's root the one that ends first.
void Fronts::share() {
  const int count = (int)all.size();
  std::vector<double> work(count);  // operations of a subtree
  std::vector<int> trees;
  double total = 0.0, above = 0.0;
  for (int k = 0; k < count; ++k) {
    work[k] += all[k].work();
    if (all[k].parent >= 0) {
      work[all[k].parent] += work[k];
    } else {
      trees.push_back(k);
      total += work[k];
    }
  }
  std::vector<int> best(count, 0);  // lane of each subtree's root; of a front above them the last
  double least = total;
  int used = 1;
  for (int cut = 0; threads > 1 && total > WORTH && !trees.empty() && cut < CUTS * threads; ++cut) {
    std::sort(trees.begin(), trees.end(),
              [&](int a, int b) { return work[a] != work[b] ? work[a] > work[b] : a < b; });
    std::vector<double> load(threads);
    std::vector<int> lane(count, threads);
    for (int tree : trees) {
      const auto light = std::min_element(load.begin(), load.end());
      lane[tree] = (int)(light - load.begin());
      *light += work[tree];
    }
    const double ends = above + *std::max_element(load.begin(), load.end());
    if (ends < least) least = ends, best = lane, used = threads;
    const int root = trees.front();
    trees.erase(trees.begin());
    above += all[root].work() / (all[root].shared() ? SHARED * threads : 1.0);
    for (int c = all[root].child; c >= 0; c = all[c].sibling) trees.push_back(c);
  }
  lanes.resize(used == 1 ? 1 : used + 1);
  for (int k = count - 1; k >= 0; --k) {  // parents first
    const bool within = used > 1 && all[k].parent >= 0 && all[all[k].parent].lane < used;
    all[k].lane = within ? all[all[k].parent].lane : best[k];
  }
}

// The order of each lane, and room for what its fronts add. Subtrees in which a run broke off come first, the
// latest before the others: where one matrix is not definite, the next one often is not, either.
void Fronts::line_up() {
  const auto earlier = [&](int a, int b) { return late[a] != late[b] ? late[a] > late[b] : a < b; };
  std::vector<int> open, order;  // fronts whose subtrees are left; parents, last ones first
  for (int k = 0; k < (int)all.size(); ++k)
    if (all[k].parent < 0) open.push_back(k);
  std::sort(open.begin(), open.end(), earlier);
  while (!open.empty()) {
    const size_t left = open.size() - 1;
    order.push_back(open.back());
    open.pop_back();
    for (int c = all[order.back()].child; c >= 0; c = all[c].sibling) open.push_back(c);
    std::sort(open.begin() + (ptrdiff_t)left, open.end(), earlier);
  }
  for (auto& lane : lanes) lane.clear();
  for (auto k = order.rbegin(); k != order.rend(); ++k) lanes[all[*k].lane].push_back(*k);
  for (size_t lane = 0; lane < lanes.size(); ++lane) {
    size_t now = 0, most = stacks[lane].size();
    for (int k : lanes[lane]) {
      most = std::max(most, now += all[k].adds());
      for (int c = all[k].child; c >= 0; c = all[c].sibling)
        if (all[c].lane == (int)lane) now -= all[c].adds();
    }
    stacks[lane].resize(most);
  }
}

bool Fronts::run(const Eliminate& eliminate) {
  broken = -1;
  Team team(subtrees());
  team.share(subtrees(), [&](int lane) {
    Team alone(1);
    run(lane, alone, eliminate);
  });
  if (lanes.size() > 1) run(subtrees(), team, eliminate);
  if (broken < 0) return true;
  ++breaks;
  for (int k = broken; k >= 0; k = all[k].parent) late[k] = breaks;
  line_up();
  return false;
}

void Fronts::run(int lane, Team& team, const Eliminate& eliminate) {
  double* top = stacks[lane].data();
  for (int k : lanes[lane]) {
    if (broken >= 0) return;
    const Front& f = all[k];
    if (!eliminate(f, top, team)) broken = k;
    const double* sum = top;  // above those of its children
    for (int c = f.child; c >= 0; c = all[c].sibling)
      if (all[c].lane == lane) top = std::min(top, sums[c]);
    std::memmove(sums[k] = top, sum, sizeof(double) * f.adds());
    top += f.adds();
  }
}

Fronts::~Fronts() {
  cholmod_free_factor(&made, &common);
  cholmod_finish(&common);
}

}  // namespace voile
