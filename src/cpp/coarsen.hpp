// Coarse levels of a triangle mesh by collapsing half edges, so that coarse vertices are fine ones.
//
// A vertex moves onto a neighbour and vanishes. Feature lines (borders, cuts of the rest shape, borders of
// fabrics, clamps and supports) keep their ends, corners and crossings: a vertex on one moves along it only.
// Vertices that are sewn together move together, along all sides of their seam. The cheapest move comes
// first: short edges, good triangles and little loss of shape, as Garland & Heckbert (1997) measure it, in
// the start and in the rest shape. Edges are flipped where that makes better triangles.
#pragma once

#include <span>
#include <vector>

namespace voile {

struct FineMesh {
  std::span<const int> corner, rest_corner;  // (3m) vertices and rest vertices
  std::span<const int> chart;                // (m) equal where the rest shape is one surface
  std::span<const double> start, rest;       // (3n), (3r) positions (m)
  std::span<const int> support;              // (n) equal for equal supports, 0 without
  std::span<const int> group;                // (n) smallest vertex that each is sewn to
  std::span<const int> locked;               // (n) 1 where the vertex must stay
  std::span<const int> feature, kind;        // (2f) vertices of feature lines' edges, (f) bits of FeatureKind
  std::span<const int> hang;            // (3k) slave, first, second: slave is sewn to the edge of the others
  std::span<const double> hang_weight;  // (k) where on it: 0 at first, 1 at second

  int vertices() const { return (int)(start.size() / 3); }
  int triangles() const { return (int)(corner.size() / 3); }
};

enum FeatureKind { BORDER = 1, CUT = 2, CLAMP = 4, FABRIC = 8, SUPPORT = 16 };

struct CoarseMesh {
  std::vector<int> triangle;  // (mc) fine triangle that each coarse one inherits fabric and chart from
  std::vector<int> corner, rest_corner;  // (3 mc) fine vertices and rest vertices
  std::vector<int> home;       // (n) coarse triangle in which each fine vertex lies in the rest shape, or -1
  std::vector<double> weight;  // (3n) its barycentric coordinates there
  std::vector<int> feature, kind;  // as FineMesh's, with fine vertices
  std::vector<int> hang;           // (3 kc) as FineMesh's
  std::vector<double> hang_weight;
};

// Collapses until `target` vertices are left, or none may go.
CoarseMesh coarsen(const FineMesh& mesh, int target);

}  // namespace voile
