// Geometry of coarsening: triangles' quality, loss of shape, barycentric coordinates.
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "vec.hpp"

namespace voile {

// A triangle's normal (twice its area), sum and largest of its squared edges.
struct Facet {
  Vec normal;
  double sum, longest;

  Facet(Vec a, Vec b, Vec c) : normal(cross(b - a, c - a)) {
    double l[] = {dot(b - a, b - a), dot(c - b, c - b), dot(a - c, a - c)};
    sum = l[0] + l[1] + l[2];
    longest = std::max({l[0], l[1], l[2]});
  }
  double quality() const { return 3.4641016151377544 * length(normal) / sum; }  // 1 for an equilateral one
  double cosine(const Facet& other) const {
    return dot(normal, other.normal) / std::max(length(normal) * length(other.normal), 1e-300);
  }
};

// Sum over triangles (edges) of area (length) times squared distance to their planes (lines), by Garland &
// Heckbert (1997).
struct Quadric {
  double a[6] = {}, b[3] = {}, c = 0.0, weight = 0.0;

  // normal: twice as long as the triangle's area
  void add_plane(Vec normal, Vec point) {
    double twice = length(normal);
    if (twice > 0.0) add(0.0, 0.5 * twice, (1.0 / twice) * normal, point, 0.5 * twice);
  }
  void add_line(Vec from, Vec to) {
    double size = length(to - from);
    if (size > 0.0) add(size, -size, (1.0 / size) * (to - from), from, size);
  }
  void add(const Quadric& q) {
    for (int i = 0; i < 6; ++i) a[i] += q.a[i];
    for (int i = 0; i < 3; ++i) b[i] += q.b[i];
    c += q.c, weight += q.weight;
  }
  // Mean squared distance of a point to the planes or lines.
  double at(Vec p) const {
    double q = a[0] * p.x * p.x + a[3] * p.y * p.y + a[5] * p.z * p.z +
               2.0 * (a[1] * p.x * p.y + a[2] * p.x * p.z + a[4] * p.y * p.z) +
               2.0 * (b[0] * p.x + b[1] * p.y + b[2] * p.z) + c;
    return std::max(q, 0.0) / std::max(weight, 1e-300);
  }

 private:
  // Adds isotropic times |x - p|^2 and along times (d . (x - p))^2.
  void add(double isotropic, double along, Vec d, Vec p, double size) {
    double dp = dot(d, p), outer[] = {d.x * d.x, d.x * d.y, d.x * d.z, d.y * d.y, d.y * d.z, d.z * d.z};
    for (int i = 0; i < 6; ++i) a[i] += along * outer[i];
    for (int i : {0, 3, 5}) a[i] += isotropic;
    b[0] -= isotropic * p.x + along * dp * d.x;
    b[1] -= isotropic * p.y + along * dp * d.y;
    b[2] -= isotropic * p.z + along * dp * d.z;
    c += isotropic * dot(p, p) + along * dp * dp;
    weight += size;
  }
};

// Barycentric coordinates of a point's projection onto a triangle's plane.
inline std::array<double, 3> barycentric(Vec p, Vec a, Vec b, Vec c) {
  Vec n = cross(b - a, c - a);
  double inverse = 1.0 / std::max(dot(n, n), 1e-300);
  double wb = dot(cross(p - a, c - a), n) * inverse, wc = dot(cross(b - a, p - a), n) * inverse;
  return {1.0 - wb - wc, wb, wc};
}

// The same of the triangle's point nearest to p.
inline std::array<double, 3> nearest(Vec p, Vec a, Vec b, Vec c) {
  std::array<double, 3> w = barycentric(p, a, b, c);
  if (w[0] >= 0.0 && w[1] >= 0.0 && w[2] >= 0.0) return w;
  const Vec x[] = {a, b, c};
  double best = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    int i = (k + 1) % 3, j = (k + 2) % 3;
    Vec e = x[j] - x[i];
    double s = std::clamp(dot(p - x[i], e) / std::max(dot(e, e), 1e-300), 0.0, 1.0);
    Vec off = p - x[i] - s * e;
    if (dot(off, off) < best) {
      best = dot(off, off);
      w[k] = 0.0, w[i] = 1.0 - s, w[j] = s;
    }
  }
  return w;
}

}  // namespace voile
