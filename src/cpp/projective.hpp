// Contacts of an iteration of Projective Dynamics with dry friction (Ly, Jouve, Boissieux &
// Bertails-Descoubes 2020): each is solved by itself, with the masses of its vertices alone.
#pragma once

#include <cstdint>
#include <vector>

namespace voile {

// A constant matrix of unknowns by rows, N/m; unknown (3n): of each vertex and axis, -1 where there is none.
struct Stiffness {
  std::vector<int32_t> start, column;
  std::vector<double> value, diagonal;
  std::vector<int32_t> unknown;

  // Moves unknown u to where its row of matrix way = force holds.
  void relax(int u, const double* force, double* way) const;
};

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

  // One pass of Gauss-Seidel over the contacts: the unknowns of each relax one after the other, then its
  // reaction becomes the one with which they obey Signorini's and Coulomb's laws, at positions x (3n) m
  // moved by the way (m) of the unknowns. force (N), the unknowns', takes the changes of the reactions up.
  // Returns the sum of squares of these changes.
  double sweep(const double* x, const Stiffness& matrix, double* force, double* way);
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
