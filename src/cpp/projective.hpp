// Contacts of an iteration of Projective Dynamics with dry friction (Ly, Jouve, Boissieux &
// Bertails-Descoubes 2020): each is solved by itself, with the masses of its vertices alone.
#pragma once

#include <cstdint>
#include <vector>

#include "doubles.hpp"

namespace voile {

// A constant matrix of nodes by rows, N/m, the same along three axes. An unknown is a node's component: slot,
// 4 node + axis. soft (4 nodes): 1/diagonal where there is an unknown, else 0. node (n): with which a vertex
// moves, -1 for none; free (4n): 1 along the axes along which it does, else 0.
struct Stiffness {
  std::vector<int32_t> start, column;
  std::vector<double> value, diagonal, soft, free;
  std::vector<int32_t> slot, node;

  // Moves node u to where its row of matrix way = force holds.
  void relax(int u, const Double4* force, Double4* way) const;
};

// Linearised: with p the weighted sum of its vertices' positions, its gap is gap + normal.(p - anchor), its
// slip the tangential part of p - start.
struct LocalContact {
  static constexpr int MOST = 4;  // vertices
  int32_t vertex[MOST];
  double weight[MOST];            // 0 where it has fewer
  double gap, friction;           // m; Coulomb's coefficient
  Double4 normal, anchor, start;  // unit; m
  Double4 reaction;               // N, on the side of positive weights

  Double4 place(const double* x) const;
  // The reaction that the laws project the trial reaction at p on; rho: N/m.
  Double4 projected(const Double4& p, double rho) const;
};

// In the order in which they are solved.
struct LocalContacts {
  std::vector<LocalContact> all;

  // Passes of Gauss-Seidel over the contacts: the nodes of each relax one after the other, then its reaction
  // becomes the one with which they obey Signorini's and Coulomb's laws, at positions x (3n) m moved by what
  // force (N), the unknowns', has led them to. At most so many, or until one changes reactions by no more
  // than the share `settled` of what the first did.
  void sweep(const double* x, const Stiffness& matrix, const double* force, int passes, double settled);
  // Adds the reactions to the vertices' forces (3n) N.
  void spread(double* force) const;
  // Sum of squares of what the reactions miss of those that the laws project on, at positions x, for the
  // contacts that count; rho (c) N/m: the natural map's (Alart & Curnier 1991).
  double mismatch(const double* x, const double* rho, const uint8_t* counts) const;

 private:
  std::vector<double> pushed, way;  // (4 nodes) N, m: the forces, and the motion by them
};

}  // namespace voile
