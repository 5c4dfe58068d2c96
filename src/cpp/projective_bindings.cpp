// Python module voile._projective: CHOLMOD's factors, and the contacts of Projective Dynamics.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>

#include <algorithm>
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
          [](Cholesky* self, In<int32_t> start, In<int32_t> column, In<double> value, In<int32_t> places) {
            const int size = (int)start.size() - 1;
            if (size < 1 || column.size() != value.size() || (size_t)start.data()[size] != value.size())
              throw nb::value_error("Cholesky: rows of a sparse matrix expected");
            if (places.ndim() != 2 || places.shape(0) > 3 || places.shape(1) != (size_t)size)
              throw nb::value_error("Cholesky: places (right-hand sides, size) expected, at most 3");
            new (self) Cholesky(size, start.data(), column.data(), value.data(), (int)places.shape(0),
                                places.data());
          },
          "start"_a, "column"_a, "value"_a, "places"_a)
      .def(
          "solve",
          [](Cholesky& self, In<double> b, Out<double> x) {
            if (b.size() < self.least()) throw nb::value_error("b");
            self.solve(b.data(), sized(x, b.size(), "x"));
          },
          "b"_a, "x"_a)
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
      .def("add",
           [](Memory& self, In<double> y, In<double> step, Out<double> out) {
             self.add(sized(y, self.length(), "y"), sized(step, self.length(), "step"),
                      sized(out, self.sums(), "out"));
           })
      .def("combine", [](Memory& self, In<double> total, Out<double> out) {
        self.combine(sized(total, self.sums(), "total"), sized(out, self.length(), "out"));
      });

  nb::class_<Stiffness>(m, "Stiffness")
      .def(
          "__init__",
          [](Stiffness* self, In<int32_t> start, In<int32_t> column, In<double> value, In<double> diagonal,
             In<double> soft, In<double> free, In<int32_t> slot, In<int32_t> node) {
            const size_t nodes = diagonal.size();
            new (self) Stiffness{copied(start, nodes + 1, "start"),    copied(column, value.size(), "column"),
                                 copied(value, value.size(), "value"), copied(diagonal, nodes, "diagonal"),
                                 copied(soft, 4 * nodes, "soft"),      copied(free, 4 * node.size(), "free"),
                                 copied(slot, slot.size(), "slot"),    copied(node, node.size(), "node")};
          },
          "start"_a, "column"_a, "value"_a, "diagonal"_a, "soft"_a, "free"_a, "slot"_a, "node"_a);

  nb::class_<LocalContacts>(m, "LocalContacts")
      .def(
          "__init__",
          [](LocalContacts* self, In<int32_t> vertex, In<double> weight, In<double> gap, In<double> normal,
             In<double> anchor, In<double> start, In<double> friction, In<double> reaction) {
            const size_t count = gap.size();
            new (self) LocalContacts{};
            self->all.resize(count);
            const int32_t* vertices = sized(vertex, 4 * count, "vertex");
            const double *weights = sized(weight, 4 * count, "weight"),
                         *rubs = sized(friction, count, "friction");
            const double* vectors[] = {sized(normal, 3 * count, "normal"), sized(anchor, 3 * count, "anchor"),
                                       sized(start, 3 * count, "start"),
                                       sized(reaction, 3 * count, "reaction")};
            for (size_t k = 0; k < count; ++k) {
              LocalContact& c = self->all[k];
              std::copy_n(vertices + 4 * k, 4, c.vertex);
              std::copy_n(weights + 4 * k, 4, c.weight);
              c.gap = gap.data()[k], c.friction = rubs[k];
              Double4* to[] = {&c.normal, &c.anchor, &c.start, &c.reaction};
              for (int i = 0; i < 4; ++i)
                *to[i] = Double4{vectors[i][3 * k], vectors[i][3 * k + 1], vectors[i][3 * k + 2], 0.0};
            }
          },
          "vertex"_a, "weight"_a, "gap"_a, "normal"_a, "anchor"_a, "start"_a, "friction"_a, "reaction"_a)
      .def(
          "sweep",
          [](LocalContacts& self, In<double> x, const Stiffness& matrix, In<double> force, int passes,
             double settled) {
            self.sweep(sized(x, 3 * matrix.node.size(), "x"), matrix,
                       sized(force, matrix.slot.size(), "force"), passes, settled);
          },
          "x"_a, "matrix"_a, "force"_a, "passes"_a, "settled"_a)
      .def(
          "spread", [](const LocalContacts& self, Out<double> force) { self.spread(force.data()); },
          "force"_a)
      .def(
          "mismatch",
          [](const LocalContacts& self, In<double> x, In<double> rho, In<uint8_t> counts) {
            return self.mismatch(x.data(), sized(rho, self.all.size(), "rho"),
                                 sized(counts, self.all.size(), "counts"));
          },
          "x"_a, "rho"_a, "counts"_a)
      .def(
          "reaction",
          [](const LocalContacts& self, Out<double> out) {
            double* to = sized(out, 3 * self.all.size(), "out");
            for (const LocalContact& c : self.all)
              for (int a = 0; a < 3; ++a) *to++ = c.reaction[a];
          },
          "out"_a);
}
