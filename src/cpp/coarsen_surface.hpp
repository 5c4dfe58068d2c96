// A mesh that loses vertices: its two shapes, feature lines, seams, and the fine vertices in its triangles.
#pragma once

#include "coarsen.hpp"
#include "coarsen_shapes.hpp"

namespace voile {

struct Line {  // an edge of a feature line, seen from one of its ends
  int other, kind;
};

struct Move {  // the first vertex goes to the second and vanishes
  int from, to;
};

using Pairs = std::vector<std::pair<int, int>>;

// Shape 0 is the start shape, whose corners are vertices; shape 1 the rest shape with corners of its own.
class Surface {
 public:
  explicit Surface(const FineMesh& mesh);

  const FineMesh& mesh;
  std::vector<int> corner[2];
  std::vector<std::vector<int>> around;  // (n) triangles at a vertex
  std::vector<std::vector<Line>> lines;  // (n) feature lines at a vertex
  std::vector<char> gone;                // (n)
  int left;                              // vertices
  int first_shape;  // 1 where the start shape is the rest shape: what holds of one does of the other

  Vec point(int shape, int index) const {
    const double* x = (shape ? mesh.rest : mesh.start).data() + 3 * (size_t)index;
    return Vec{x[0], x[1], x[2]} - origin_[shape];
  }
  Vec at(int shape, int t, int k) const { return point(shape, corner[shape][3 * t + k]); }
  Facet facet(int shape, int t) const { return {at(shape, t, 0), at(shape, t, 1), at(shape, t, 2)}; }
  int find(int t, int vertex) const {  // corner of a triangle, or -1
    for (int k = 0; k < 3; ++k)
      if (corner[0][3 * t + k] == vertex) return k;
    return -1;
  }
  int rest_of(int t, int vertex) const { return corner[1][3 * t + find(t, vertex)]; }
  const Line* line(int a, int b) const {
    for (const Line& l : lines[a])
      if (l.other == b) return &l;
    return nullptr;
  }

  // The rest vertex that takes the place of one at move.from, or -1.
  int rest_after(Move move, int from) const {
    for (int t : around[move.from])
      if (find(t, move.to) >= 0 && rest_of(t, move.from) == from) return rest_of(t, move.to);
    return -1;
  }

  bool allows(Move move) const;
  Pairs collapse(Move move);
  bool flip(int t, int k);
  void flip_around(int vertex);
  void flip_all();
  CoarseMesh result() const;

 private:
  Vec origin_[2] = {};
  std::vector<std::vector<int>> inside_;  // fine vertices in a triangle
  std::vector<char> alive_;               // triangles
  std::vector<int> place_, chart_of_;  // (n) rest vertex by which a vertex that is gone is located; its chart
  std::vector<int> hang_;              // the mesh's, -1 for the slave where the record is gone
  std::vector<double> hang_weight_;
  std::vector<std::vector<int>> hosts_, hangs_;  // (n) records with a vertex as an end, as the slave
  std::vector<int> in_group_;                    // vertices of a group
  mutable std::vector<int> mark_;                // (n)
  mutable int stamp_ = 0;

  // Where the feature line through move.from goes on.
  int next(Move move) const { return lines[move.from][lines[move.from][0].other == move.to].other; }
  bool follows_line(Move move) const;
  bool follows_seams(Move move) const;
  bool sewn_beside(int vertex, int record) const;
  bool stays_surface(Move move) const;
  void slide_seams(Move move);
  void relocate(const std::vector<int>& points, const std::vector<int>& triangles);
};

}  // namespace voile
