// Sparse Cholesky factors of matrices that change while their pattern stays: Newton's method downhill.
#pragma once

#include <cholmod.h>

#include <cstdint>
#include <vector>

namespace voile {

// L L^T of symmetric matrices of one pattern. CHOLMOD (Davis et al., SuiteSparse) orders, analyses and
// solves: L lies in its supernodes, groups of columns with the same rows. The factor itself is by fronts
// (multifrontal method, Duff & Reid 1983; Liu 1992): at 700 to 2,600 unknowns 1.4 to 1.7 times as fast as
// CHOLMOD's, which permutes the matrix anew, calls BLAS ten times as often, and asks OpenMP for threads.
class Definite {
 public:
  // The pattern, rows of both triangles, columns ascending. Throws std::runtime_error.
  Definite(int size, const int32_t* start, const int32_t* column);
  ~Definite();
  Definite(const Definite&) = delete;
  Definite& operator=(const Definite&) = delete;

  // Factors the entries; false where they are not positive definite, found at the first pivot that is not.
  bool factor(const double* value);
  // x = A^-1 b with the last factor.
  void solve(const double* b, double* x);
  int size() const { return (int)made->n; }
  int entries() const { return given; }
  const cholmod_factor& factored() const { return *made; }

 private:
  // A supernode's `width` columns and, below, what they add to the later ones: `height` rows in all. panel:
  // its place in L; into: that of its rows below in `place`; child, sibling: the last front that adds to it,
  // the one before that adds to the same; -1 for none.
  struct Front {
    int width, height;
    size_t panel, into;
    int child, sibling;
  };
  // An entry of the matrix and where it goes in L.
  struct Entry {
    int32_t from;
    size_t to;
  };

  void add(const Front& child, const double* update, const Front& parent, double* panel, double* sum) const;

  int given;  // entries of the matrix
  cholmod_common common;
  cholmod_factor* made = nullptr;
  cholmod_dense *result = nullptr, *between = nullptr, *beside = nullptr;  // kept from solve to solve
  std::vector<Front> fronts;                                               // children before parents
  std::vector<Entry> lower;                                                // one triangle
  std::vector<int32_t> place;   // of fronts' rows below among the parent's
  std::vector<double> updates;  // a stack
};

}  // namespace voile
