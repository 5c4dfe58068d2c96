// Elastic energy of a triangle mesh: what Python and the assembly see of a model, whatever the instruction
// set.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace voile {

struct Scatter;

// A mesh as one rank holds it. Corner i of a triangle is opposite its edge i; half edge = 3*triangle +
// corner.
struct Mesh {
  int vertices = 0, edges = 0, triangles = 0;
  std::vector<int> corner;    // (3m) vertices
  std::vector<int> edge;      // (3m) edge opposite each corner
  std::vector<int> sign;      // (3m) +1 where the triangle runs along the edge's own direction
  std::vector<int> across;    // (3m) half edge on the other side, -1 on a boundary
  std::vector<double> start;  // (3n) positions from which displacements count
};

// A half edge whose director is held in space (a clamp). vector: the unit vector held: the director itself
// (conormal false) or the in-plane normal of the edge (conormal true). at_rest: the
// rest shape lies where the clamp is and is at rest in it as it lies there; alpha then counts from the middle
// between the clamp and the rest shape. angle: the part of the edge's director angle that never changes.
struct Clamp {
  int half_edge;
  bool conormal, at_rest;
  double vector[3], angle;
};

// exact; safe: positive semidefinite; mixed: exact but for the stresses of its geometric part, which are
// those that the last `predict` extrapolated (Magisano, Leonetti & Garcea 2017: mixed integration points;
// Newton's method then converges in few steps where bending couples with stiff stretching). share: of the
// safe one, the rest is exact.
enum class Hessian { exact, safe, mixed };

// Displacements (3n) from mesh.start and director angles (edges), both in local numbering.
struct State {
  const double* displacement;
  const double* director;
};

class Elastic {
 public:
  virtual ~Elastic() = default;

  virtual void set_clamps(const std::vector<Clamp>& clamps) = 0;
  // Rest shape: a mesh with the same triangles and vertex numbering of its own; flat rests have no fold.
  // Clamps come first.
  virtual void set_rest(const double* points, const int* corners, bool flat) = 0;
  // Per triangle: thickness (m), Young's modulus (Pa), Poisson's ratio.
  virtual void set_fabric(const double* thickness, const double* young, const double* poisson) = 0;
  // Per triangle the LENGTH numbers of a Weave (models.hpp); woven materials only, others pass over it.
  virtual void set_weave(const double* weave) = 0;
  // Only triangles with weight 1 count in the energy (each triangle counts on one rank).
  virtual void set_weights(const double* weight) = 0;

  // Energies (J): stretching, bending.
  virtual void energy(State state, double* split) = 0;
  // Adds the forces' negatives to gradient (3n) and edge_gradient (edges); returns the energies as above.
  virtual void gradient(State state, double* split, double* gradient, double* edge_gradient) = 0;
  virtual void hessian(State state, Hessian kind, double share, Scatter& scatter) = 0;
  // Stresses W_q linearised at the state, extrapolated along a direction (3n; edges).
  virtual void predict(State state, State direction) = 0;
  // End moments: psi_h is the turn of half edge h's triangle about it. turn_gradient adds sum_h weight_h
  // dpsi_h/dx; weights that were set also enter the Hessian (symmetrised; exact where the edge only moves,
  // not tilts).
  virtual void turn_gradient(State state, const double* weight, double* gradient) = 0;
  virtual void set_turn_weights(const double* weight) = 0;

  // Per triangle: second derivatives of W with respect to q (6) and q_rest (6): (m, 6, 6), and to thickness,
  // Young's modulus, Poisson's ratio: (m, 6, 3); first derivatives to those three: (m, 3).
  virtual void mixed(State state, double* q_rest, double* q_fabric, double* fabric) = 0;
  // A rate of q (m, 6) times what `mixed` gives for q_rest, at a tenth of its cost: (m, 6).
  virtual void mixed_along(State state, const double* rate, double* slope) = 0;
  // dq/dx in 18 + 3 columns per triangle: own corners, vertices across edges, edges: (m, 6, 21).
  virtual void invariants_jacobian(State state, double* jacobian) = 0;
  // The same at the rest shape (columns: rest vertices; the directors' columns are those of alpha_rest).
  virtual void rest_jacobian(double* jacobian) = 0;
  // Per triangle: the six invariants l (m, 3), alpha (m, 3).
  virtual void invariants(State state, double* lengths, double* angles) = 0;

  // Per triangle: energies (J) of stretching and bending, the first's derivatives with respect to the l, the
  // second's with respect to the alpha: (m, 8).
  virtual void stresses(State state, double* out) = 0;

  // Per half edge (3m): the sign of the sine of half the fold where that is within 90 degrees of 180 and may
  // go on through them, 0 where it is none of this. A fold that has gone on through 270 degrees is one the
  // other way.
  virtual void fold_sides(State state, int* sides) = 0;
  // Folds go on from these sides: at first none does.
  virtual void set_sides(const int* sides) = 0;

  // Whether some hinge turns through 180 degrees on the way between two states. Those within 0.1 degrees of
  // it at the start do not count: it is not known on which side they are.
  virtual bool folds_over(State before, State after) = 0;

  virtual bool bends() const = 0;
  virtual bool directors() const = 0;
};

// name: "model/bending/material", empty parts where the model has none. Picks the widest instruction set of
// this machine (environment variable VOILE_ISA overrides). Throws std::invalid_argument for an unknown name.
std::unique_ptr<Elastic> make_elastic(const std::string& name, Mesh mesh);
std::string instruction_set();

}  // namespace voile
