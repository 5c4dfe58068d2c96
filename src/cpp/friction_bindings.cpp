// Python module voile._friction: the solver of discrete frictional contact problems.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "coulomb.hpp"
#include "friction.hpp"

namespace nb = nanobind;

template <class T>
using Array = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

template <class T>
static std::span<const T> span(const Array<T>& a) {
  return {a.data(), a.size()};
}

static voile::FrictionSolution solve(const Array<int>& start, const Array<int>& column,
                                     const Array<double>& blocks, const Array<double>& q,
                                     const Array<double>& mu, double tol, int max_iterations) {
  nb::gil_scoped_release release;
  return voile::solve_friction({span(start), span(column), span(blocks), span(q), span(mu)}, tol,
                               max_iterations);
}

template <class T>
using Output = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

static void natural_maps(const Array<double>& r, const Array<double>& u, const Array<double>& mu, double rho,
                         const Output<double>& F, const Output<double>& A, const Output<double>& B,
                         const Output<signed char>& state) {
  for (size_t i = 0; i < mu.size(); ++i) {
    const voile::NaturalMap m = voile::natural_map(r.data() + 3 * i, u.data() + 3 * i, mu.data()[i], rho);
    std::ranges::copy(m.F, F.data() + 3 * i);
    std::ranges::copy(m.A, A.data() + 9 * i);
    std::ranges::copy(m.B, B.data() + 9 * i);
    state.data()[i] = (signed char)m.state;
  }
}

NB_MODULE(_friction, m) {
  m.doc() = "Discrete frictional contact problems: proximal-point semismooth Newton method.";
  nb::class_<voile::FrictionSolution>(m, "FrictionSolution")
      .def_prop_ro("reaction",
                   [](const voile::FrictionSolution& s) {
                     return nb::ndarray<nb::numpy, const double>(s.reaction.data(), {s.reaction.size()},
                                                                 nb::find(s));
                   })
      .def_ro("converged", &voile::FrictionSolution::converged)
      .def_ro("error", &voile::FrictionSolution::error)
      .def_ro("proximal_steps", &voile::FrictionSolution::proximal_steps)
      .def_ro("iterations", &voile::FrictionSolution::iterations)
      .def_ro("factorisations", &voile::FrictionSolution::factorisations)
      .def_ro("history", &voile::FrictionSolution::history);
  m.def("solve_friction", &solve, nb::arg("start"), nb::arg("column"), nb::arg("blocks"), nb::arg("q"),
        nb::arg("mu"), nb::arg("tol"), nb::arg("max_iterations"));
  m.def("natural_map", &natural_maps, nb::arg("r"), nb::arg("u"), nb::arg("mu"), nb::arg("rho"), nb::arg("F"),
        nb::arg("A"), nb::arg("B"), nb::arg("state"));
}
