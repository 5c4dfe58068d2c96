// Contacts of an iteration of Projective Dynamics with dry friction (Ly, Jouve, Boissieux &
// Bertails-Descoubes 2020): each is solved by itself, with the masses of its vertices alone.
#pragma once

#include <cstdint>
#include <vector>

namespace voile {

// Linearised: with p the weighted sum of its vertices' positions, its gap is gap + normal.(p - anchor), its
// slip the tangential part of p - start. In the order in which they are solved.
struct LocalContacts {
  static constexpr int MOST = 4;  // vertices of a contact
  std::vector<int32_t> vertex;    // (4c)
  std::vector<double> weight;     // (4c), 0 where it has fewer
  std::vector<double> gap;        // (c) m
  std::vector<double> normal;     // (3c) unit
  std::vector<double> anchor;     // (3c) m
  std::vector<double> start;      // (3c) m
  std::vector<double> friction;   // (c) Coulomb's coefficient
  std::vector<double> reaction;   // (3c) N, on the side of positive weights

  int count() const { return (int)gap.size(); }

  // One pass of Gauss-Seidel over the contacts: each reaction becomes the one with which its vertices, moved
  // by it over their inertia (N/m), obey Signorini's and Coulomb's laws; x (3n) m moves along. Returns the
  // sum of squares of the reactions' changes.
  double sweep(double* x, const double* inertia);
  // Adds the reactions to the vertices' forces (3n) N.
  void spread(double* force) const;
  // Sum of squares of what the reactions miss of those that the laws project on, at positions x, for the
  // contacts that count; rho (c) N/m: the natural map's (Alart & Curnier 1991).
  double mismatch(const double* x, const double* rho, const uint8_t* counts) const;

 private:
  void place(int c, const double* x, double p[3]) const;
  void project(int c, const double p[3], double rho, double r[3]) const;
};

}  // namespace voile
