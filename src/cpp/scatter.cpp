#include "scatter.hpp"

#include <algorithm>
#include <cstring>

namespace voile {
namespace {

constexpr int WORTH = 2500;  // triangles of a thread, which take 1 ms, five times as long as its start

}  // namespace

Scatter::Scatter(const Mesh& mesh, bool with_edges, int owned_unknowns, std::vector<int> c_start,
                 std::vector<int> c_unknown, std::vector<double> c_weight, int threads)
    : owned(owned_unknowns),
      nodes(with_edges ? NODES : 6),
      dof_start(std::move(c_start)),
      dof_unknown(std::move(c_unknown)),
      dof_weight(std::move(c_weight)),
      vertices(mesh.vertices) {
  int m = mesh.triangles;
  parts = std::clamp(m / WORTH, 1, std::clamp(threads, 1, 8));
  run = ((m + parts - 1) / parts + 15) / 16 * 16;  // whole blocks of the kernels
  triangle_node.assign((size_t)NODES * m, -1);
  for (int t = 0; t < m; ++t)
    for (int i = 0; i < 3; ++i) {
      int* node = &triangle_node[(size_t)NODES * t];
      int other = mesh.across[3 * t + i];
      node[i] = mesh.corner[3 * t + i];
      node[3 + i] = other < 0 ? -1 : mesh.corner[other];
      node[6 + i] = with_edges ? mesh.vertices + mesh.edge[3 * t + i] : -1;
    }
  first.assign(mesh.vertices + mesh.edges, -1);
  for (int k = 0; k < mesh.vertices + mesh.edges; ++k) {
    bool vertex = k < mesh.vertices;
    if (!vertex && !with_edges) continue;
    int dof = vertex ? 3 * k : 2 * mesh.vertices + k, size = vertex ? 3 : 1;
    int terms = dof_start[dof + size] - dof_start[dof];
    if (terms == 0) continue;
    bool identity = terms == size;
    for (int r = 0; identity && r < size; ++r) {
      int at = dof_start[dof + r];
      identity = dof_start[dof + r + 1] == at + 1 && dof_weight[at] == 1.0 &&
                 dof_unknown[at] == dof_unknown[dof_start[dof]] + r;
    }
    first[k] = identity ? dof_unknown[dof_start[dof]] : -2;
  }
}

int Scatter::triangle_dof(int t, int k) const {
  int a = k < 18 ? k / 3 : k - 12;
  int node = triangle_node[(size_t)NODES * t + a];
  if (node < 0) return -1;
  return a < 6 ? 3 * node + k % 3 : 2 * vertices + node;
}

void Scatter::pattern(const int64_t* rank, std::vector<int64_t>& start, std::vector<int>& column) const {
  int m = count(), dofs = nodes == NODES ? DOFS : 18;
  // Unknowns of each triangle, then triangles of each owned unknown.
  std::vector<int64_t> unknown_start(m + 1, 0);
  std::vector<int> unknown;
  unknown.reserve((size_t)m * dofs);
  for (int t = 0; t < m; ++t) {
    size_t begin = unknown.size();
    for (int k = 0; k < dofs; ++k) {
      int dof = triangle_dof(t, k);
      if (dof < 0) continue;
      for (int at = dof_start[dof]; at < dof_start[dof + 1]; ++at) unknown.push_back(dof_unknown[at]);
    }
    std::sort(unknown.begin() + begin, unknown.end());
    unknown.erase(std::unique(unknown.begin() + begin, unknown.end()), unknown.end());
    unknown_start[t + 1] = (int64_t)unknown.size();
  }
  std::vector<int64_t> use_start(owned + 1, 0);
  for (int u : unknown)
    if (u < owned) ++use_start[u + 1];
  for (int u = 0; u < owned; ++u) use_start[u + 1] += use_start[u];
  std::vector<int> use(use_start[owned]);
  std::vector<int64_t> fill(use_start.begin(), use_start.end() - 1);
  for (int t = 0; t < m; ++t)
    for (int64_t k = unknown_start[t]; k < unknown_start[t + 1]; ++k)
      if (unknown[k] < owned) use[fill[unknown[k]]++] = t;
  start.assign(owned + 1, 0);
  column.clear();
  std::vector<int> row, previous_use;
  for (int u = 0; u < owned; ++u) {
    auto begin = use.begin() + use_start[u], end = use.begin() + use_start[u + 1];
    bool same = u > 0 && begin != end && std::equal(begin, end, previous_use.begin(), previous_use.end());
    if (!same) {
      row.assign(1, u);  // the diagonal is always there
      for (auto t = begin; t != end; ++t)
        row.insert(row.end(), unknown.begin() + unknown_start[*t], unknown.begin() + unknown_start[*t + 1]);
      std::sort(row.begin(), row.end(), [rank](int a, int b) { return rank[a] < rank[b]; });
      row.erase(std::unique(row.begin(), row.end()), row.end());
      previous_use.assign(begin, end);
    }
    column.insert(column.end(), row.begin(), row.end());
    start[u + 1] = (int64_t)column.size();
  }
}

int Scatter::find(int row, int unknown) const {
  bool local = unknown < owned;
  const Rows& rows = local ? inside : outside;
  if (!local && !rows.start) return ABSENT;
  int wanted = local ? unknown : ghost_column[unknown - owned];
  const int *begin = rows.column + rows.start[row], *end = rows.column + rows.start[row + 1];
  const int* at = std::lower_bound(begin, end, wanted);
  if (at == end || *at != wanted) return ABSENT;
  return local ? (int)(at - begin) : ~(int)(at - begin);
}

void Scatter::bind(Rows inside_rows, Rows outside_rows, std::vector<int> ghost_columns) {
  inside = inside_rows;
  outside = outside_rows;
  ghost_column = std::move(ghost_columns);
  if (!position.empty()) return;  // the pattern is the same, only the values' address may have changed
  order_rows();
  int m = count();
  // The fast path wants the three rows of a vertex alike; a constraint on some axes only may break that.
  auto alike = [](const Rows& rows, int row, int other) {
    return !rows.start || std::equal(rows.column + rows.start[row], rows.column + rows.start[row + 1],
                                     rows.column + rows.start[other], rows.column + rows.start[other + 1]);
  };
  for (int k = 0; k < vertices; ++k)
    for (int r = 1; r < 3 && first[k] >= 0 && first[k] < owned; ++r)
      if (!alike(inside, first[k], first[k] + r) || !alike(outside, first[k], first[k] + r)) first[k] = -2;
  plain.assign(m, 1);
  for (int t = 0; t < m; ++t)
    for (int a = 0; a < nodes; ++a) {
      int node = triangle_node[(size_t)NODES * t + a];
      if (node >= 0 && first[node] == -2) plain[t] = 0;
    }
  position.assign((size_t)nodes * nodes * m, ABSENT);
  for (int t = 0; t < m; ++t) {
    if (!plain[t]) continue;
    const int* node = &triangle_node[(size_t)NODES * t];
    for (int a = 0; a < nodes; ++a) {
      int row = node[a] < 0 ? -1 : first[node[a]];
      if (row < 0 || row >= owned) continue;
      for (int b = 0; b < nodes; ++b)
        if (node[b] >= 0 && first[node[b]] >= 0)
          position[(size_t)nodes * nodes * t + a * nodes + b] = find(row, first[node[b]]);
    }
  }
}

// Runs of rows in the order of first touch; behind the last triangle's those that no triangle touches.
void Scatter::order_rows() {
  int m = count();
  std::vector<char> seen(owned, 0);
  std::vector<int> rows;
  part.assign(owned, 0);
  touched.assign(m, 0);
  auto close = [&] {
    std::sort(rows.begin(), rows.end());
    for (size_t k = 0; k < rows.size(); ++k) {
      if (k == 0 || rows[k] != rows[k - 1] + 1) fresh.insert(fresh.end(), {rows[k], rows[k]});
      fresh.back() = rows[k] + 1;
    }
    rows.clear();
    fresh_start.push_back((int)fresh.size());
  };
  fresh_start.assign(1, 0);
  for (int t = 0; t < m; ++t) {
    for (int k = 0; k < DOFS; ++k) {
      int dof = triangle_dof(t, k);
      for (int at = dof < 0 ? 0 : dof_start[dof]; dof >= 0 && at < dof_start[dof + 1]; ++at) {
        int row = dof_unknown[at];
        if (row >= owned) continue;
        if (!seen[row]) {
          seen[row] = 1;
          part[row] = (uint8_t)(t / run);
          rows.push_back(row);
        }
        touched[t] |= (uint8_t)(1 << part[row]);
      }
    }
    close();
  }
  for (int row = 0; row < owned; ++row)
    if (!seen[row]) rows.push_back(row);
  close();
}

void Scatter::zero_fresh(int t) {
  if (adding) return;
  for (int k = fresh_start[t]; k < fresh_start[t + 1]; k += 2)
    for (const Rows& rows : {inside, outside})
      if (rows.start)
        std::memset(rows.value + rows.start[fresh[k]], 0,
                    sizeof(double) * (rows.start[fresh[k + 1]] - rows.start[fresh[k]]));
}

void Scatter::clear() { zero_fresh(count()); }

void Scatter::add_vertex(int vertex, const double* block) {
  for (int i = 0; i < 3; ++i)
    for (int p = dof_start[3 * vertex + i]; p < dof_start[3 * vertex + i + 1]; ++p) {
      int row = dof_unknown[p];
      if (row >= owned) continue;
      for (int j = 0; j < 3; ++j)
        for (int q = dof_start[3 * vertex + j]; q < dof_start[3 * vertex + j + 1]; ++q)
          at(row, dof_unknown[q]) += dof_weight[p] * dof_weight[q] * block[3 * i + j];
    }
}

template <class Entry>
void Scatter::expand(int t, int dofs, int mine, Entry entry) {
  for (int i = 0; i < dofs; ++i) {
    int row_dof = triangle_dof(t, i);
    if (row_dof < 0) continue;
    for (int p = dof_start[row_dof]; p < dof_start[row_dof + 1]; ++p) {
      int row = dof_unknown[p];
      if (!has(row, mine)) continue;
      for (int j = 0; j < dofs; ++j) {
        int column_dof = triangle_dof(t, j);
        if (column_dof < 0) continue;
        for (int q = dof_start[column_dof]; q < dof_start[column_dof + 1]; ++q)
          at(row, dof_unknown[q]) += dof_weight[p] * dof_weight[q] * entry(i, j);
      }
    }
  }
}

void Scatter::add_square(int t, const double* block) {
  int dofs = nodes == NODES ? DOFS : 18;
  if (!plain[t]) {
    expand(t, dofs, ALL, [block](int i, int j) { return block[DOFS * i + j]; });
    return;
  }
  const int* node = &triangle_node[(size_t)NODES * t];
  const int* place = &position[(size_t)nodes * nodes * t];
  for (int a = 0; a < nodes; ++a) {
    int row = node[a] < 0 ? -1 : first[node[a]];
    if (row < 0 || row >= owned) continue;
    for (int b = 0; b < nodes; ++b) {
      int to = place[a * nodes + b];
      if (to == ABSENT) continue;
      const Rows& target = to >= 0 ? inside : outside;
      for (int r = 0; r < node_size(a); ++r) {
        double* value = target.value + target.start[row + r] + (to >= 0 ? to : ~to);
        const double* source = block + DOFS * (node_dof(a) + r) + node_dof(b);
        for (int c = 0; c < node_size(b); ++c) value[c] += source[c];
      }
    }
  }
}

double& Scatter::at(int row, int unknown) {
  int place = find(row, unknown);
  const Rows& target = place >= 0 ? inside : outside;
  return target.value[target.start[row] + (place >= 0 ? place : ~place)];
}

void Scatter::add_expanded(int t, const double* block, int mine) {
  expand(t, nodes == NODES ? DOFS : 18, mine, [block](int i, int j) {
    int a = i < 18 ? i / 3 : i - 12, b = j < 18 ? j / 3 : j - 12;
    int r = i - node_dof(a), c = j - node_dof(b);
    return a <= b ? block[BLOCKS.start[a][b] + r * node_size(b) + c]
                  : block[BLOCKS.start[a][b] + c * node_size(a) + r];
  });
}

}  // namespace voile
