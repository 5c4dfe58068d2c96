// Python module voile._projective: CHOLMOD's factors, and the contacts of Projective Dynamics.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>

#include <stdexcept>

#include "anderson.hpp"
#include "cholesky.hpp"
#include "definite.hpp"
#include "general.hpp"
#include "projective.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace voile;

template <class T>
using In = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
template <class T>
using Out = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

template <class Array>
static auto* sized(const Array& array, size_t size, const char* name) {
  if (array.size() != size) throw nb::value_error(name);
  return array.data();
}

template <class T>
static std::vector<T> copied(const In<T>& a, size_t size, const char* name) {
  const T* data = sized(a, size, name);
  return std::vector<T>(data, data + size);
}

// Factors of matrices of one pattern.
template <class Factor>
void bind_factor(nb::module_& m, const char* name) {
  nb::class_<Factor>(m, name)
      .def(nb::init<std::shared_ptr<Fronts>>(), "fronts"_a)
      .def(
          "factor",
          [](Factor& self, In<double> value) { return self.factor(sized(value, self.by().given, "value")); },
          "value"_a)
      .def(
          "solve",
          [](Factor& self, In<double> b, Out<double> x, bool transposed) {
            const size_t size = self.by().size(), sides = b.size() / size;
            self.solve(sized(b, size * sides, "b"), sized(x, size * sides, "x"), (int)sides, transposed);
          },
          "b"_a, "x"_a, "transposed"_a = false);
}

NB_MODULE(_projective, m) {
  nb::class_<Cholesky>(m, "Cholesky")
      .def(
          "__init__",
          [](Cholesky* self, In<int32_t> start, In<int32_t> column, In<double> value) {
            const int size = (int)start.size() - 1;
            if (size < 1 || column.size() != value.size() || (size_t)start.data()[size] != value.size())
              throw nb::value_error("Cholesky: rows of a sparse matrix expected");
            new (self) Cholesky(size, start.data(), column.data(), value.data());
          },
          "start"_a, "column"_a, "value"_a)
      .def(
          "solve",
          [](Cholesky& self, Out<double> b) {
            if (b.ndim() != 2 || b.shape(0) > 4 || b.shape(1) != (size_t)self.size())
              throw nb::value_error("solve: (right-hand sides, size) expected, at most 4");
            self.solve(b.data(), (int)b.shape(0));
          },
          "b"_a)
      .def_prop_ro("nonzeros", &Cholesky::nonzeros);

  nb::class_<Fronts>(m, "Fronts", nb::is_weak_referenceable())
      .def(
          "__init__",
          [](Fronts* self, In<int32_t> start, In<int32_t> column, int threads) {
            const int size = (int)start.size() - 1;
            if (size < 1 || (size_t)start.data()[size] != column.size())
              throw nb::value_error("rows of a sparse matrix expected");
            new (self) Fronts(size, start.data(), column.data(), threads);
          },
          "start"_a, "column"_a, "threads"_a = 1);
  bind_factor<Definite>(m, "Definite");
  bind_factor<General>(m, "General");

  nb::class_<Memory>(m, "Memory")
      .def(nb::init<int, int>(), "size"_a, "depth"_a)
      .def("forget", &Memory::forget)
      .def_prop_ro("kept", &Memory::kept)
      .def_prop_ro("newest", &Memory::newest)
      .def("add",
           [](Memory& self, In<double> y, In<double> step) {
             self.add(sized(y, self.length(), "y"), sized(step, self.length(), "step"));
           })
      .def("products",
           [](const Memory& self, Out<double> out) { self.products(sized(out, 2 * self.most(), "out")); })
      .def("combine", [](const Memory& self, In<double> share, Out<double> out) {
        self.combine(sized(share, self.kept(), "share"), sized(out, self.length(), "out"));
      });

  nb::class_<Stiffness>(m, "Stiffness")
      .def(
          "__init__",
          [](Stiffness* self, In<int32_t> start, In<int32_t> column, In<double> value, In<double> diagonal,
             In<int32_t> unknown) {
            new (self)
                Stiffness{copied(start, diagonal.size() + 1, "start"), copied(column, value.size(), "column"),
                          copied(value, value.size(), "value"), copied(diagonal, diagonal.size(), "diagonal"),
                          copied(unknown, unknown.size(), "unknown")};
          },
          "start"_a, "column"_a, "value"_a, "diagonal"_a, "unknown"_a);

  nb::class_<LocalContacts>(m, "LocalContacts")
      .def(
          "__init__",
          [](LocalContacts* self, In<int32_t> vertex, In<double> weight, In<double> gap, In<double> normal,
             In<double> anchor, In<double> start, In<double> friction, In<double> reaction) {
            const size_t c = gap.size();
            new (self) LocalContacts{copied(vertex, 4 * c, "vertex"), copied(weight, 4 * c, "weight"),
                                     copied(gap, c, "gap"),           copied(normal, 3 * c, "normal"),
                                     copied(anchor, 3 * c, "anchor"), copied(start, 3 * c, "start"),
                                     copied(friction, c, "friction"), copied(reaction, 3 * c, "reaction")};
          },
          "vertex"_a, "weight"_a, "gap"_a, "normal"_a, "anchor"_a, "start"_a, "friction"_a, "reaction"_a)
      .def(
          "sweep",
          [](LocalContacts& self, In<double> x, const Stiffness& matrix, Out<double> force, Out<double> way) {
            const size_t size = matrix.diagonal.size();
            return self.sweep(sized(x, matrix.unknown.size(), "x"), matrix, sized(force, size, "force"),
                              sized(way, size, "way"));
          },
          "x"_a, "matrix"_a, "force"_a, "way"_a)
      .def(
          "spread", [](const LocalContacts& self, Out<double> force) { self.spread(force.data()); },
          "force"_a)
      .def(
          "mismatch",
          [](const LocalContacts& self, In<double> x, In<double> rho, In<uint8_t> counts) {
            return self.mismatch(x.data(), sized(rho, self.gap.size(), "rho"),
                                 sized(counts, self.gap.size(), "counts"));
          },
          "x"_a, "rho"_a, "counts"_a)
      .def(
          "reaction",
          [](const LocalContacts& self, Out<double> out) {
            std::copy(self.reaction.begin(), self.reaction.end(), sized(out, self.reaction.size(), "out"));
          },
          "out"_a);
}
