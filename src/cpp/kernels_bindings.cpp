// Python module voile._kernels: arrays in, arrays out; shapes are checked here.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>

#include "coarsen.hpp"
#include "elastic.hpp"
#include "loads.hpp"
#include "proximity.hpp"
#include "scatter.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using namespace voile;

using Doubles = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using Ints = nb::ndarray<const int32_t, nb::c_contig, nb::device::cpu>;
using Longs = nb::ndarray<const int64_t, nb::c_contig, nb::device::cpu>;

template <class Array>
static auto* sized(const Array& array, size_t size, const char* name) {
  if (array.size() != size)
    throw nb::value_error((std::string(name) + ": " + std::to_string(size) + " numbers expected, got " +
                           std::to_string(array.size()))
                              .c_str());
  return array.data();
}

template <class T>
static nb::ndarray<nb::numpy, T> to_numpy(std::vector<T> values, std::vector<size_t> shape) {
  auto* held = new std::vector<T>(std::move(values));
  nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T>(held->data(), shape.size(), shape.data(), owner);
}

template <class T>
static std::vector<T> copied(const nb::ndarray<const T, nb::c_contig, nb::device::cpu>& a) {
  return std::vector<T>(a.data(), a.data() + a.size());
}

struct Model {
  Mesh mesh;
  std::unique_ptr<Elastic> elastic;

  Model(const std::string& name, Ints triangles, Ints triangle_edges, Ints signs, Ints across, int edges,
        Doubles start) {
    mesh.triangles = (int)(triangles.size() / 3);
    mesh.vertices = (int)(start.size() / 3);
    mesh.edges = edges;
    size_t count = 3 * (size_t)mesh.triangles;
    for (auto* a : {&triangles, &triangle_edges, &signs, &across}) sized(*a, count, "mesh");
    mesh.corner = copied(triangles);
    mesh.edge = copied(triangle_edges);
    mesh.sign = copied(signs);
    mesh.across = copied(across);
    mesh.start = copied(start);
    for (size_t k = 0; k < count; ++k)
      if (mesh.corner[k] < 0 || mesh.corner[k] >= mesh.vertices || (edges && mesh.edge[k] < 0) ||
          mesh.edge[k] >= edges || mesh.across[k] >= (int)count)
        throw nb::value_error("mesh: index out of range");
    elastic = make_elastic(name, mesh);
    if (elastic->directors() && !edges && count) throw nb::value_error("mesh: directors need edges");
  }

  State state(const Doubles& u, const Doubles& phi) const {
    return {sized(u, 3 * (size_t)mesh.vertices, "displacement"), sized(phi, mesh.edges, "directors")};
  }
  size_t count() const { return (size_t)mesh.triangles; }
};

using Split = std::pair<double, double>;

static void bind_model(nb::module_& m) {
  nb::class_<Model>(m, "Elastic")
      .def(nb::init<const std::string&, Ints, Ints, Ints, Ints, int, Doubles>(), "name"_a, "triangles"_a,
           "triangle_edges"_a, "signs"_a, "across"_a, "edges"_a, "start"_a)
      .def_prop_ro("bends", [](Model& s) { return s.elastic->bends(); })
      .def_prop_ro("directors", [](Model& s) { return s.elastic->directors(); })
      .def("set_rest",
           [](Model& s, Doubles points, Ints corners, bool flat) {
             const int* c = sized(corners, 3 * s.count(), "rest triangles");
             for (size_t k = 0; k < corners.size(); ++k)
               if (c[k] < 0 || 3 * (size_t)c[k] + 2 >= points.size())
                 throw nb::value_error("rest: index out of range");
             s.elastic->set_rest(points.data(), c, flat);
           })
      .def("set_fabric",
           [](Model& s, Doubles thickness, Doubles young, Doubles poisson) {
             s.elastic->set_fabric(sized(thickness, s.count(), "thickness"), sized(young, s.count(), "young"),
                                   sized(poisson, s.count(), "poisson"));
           })
      .def("set_weave", [](Model& s, Doubles w) { s.elastic->set_weave(sized(w, 9 * s.count(), "weave")); })
      .def("set_weights", [](Model& s, Doubles w) { s.elastic->set_weights(sized(w, s.count(), "weights")); })
      .def("set_turn_weights",
           [](Model& s, Doubles w) { s.elastic->set_turn_weights(sized(w, 3 * s.count(), "turn weights")); })
      .def("set_clamps",
           [](Model& s, Ints half_edges, Ints conormal, Ints at_rest, Doubles vectors, Doubles angles) {
             std::vector<Clamp> clamps(half_edges.size());
             sized(conormal, clamps.size(), "conormal");
             sized(at_rest, clamps.size(), "at_rest");
             sized(vectors, 3 * clamps.size(), "vectors");
             sized(angles, clamps.size(), "angles");
             for (size_t k = 0; k < clamps.size(); ++k) {
               const double* v = vectors.data() + 3 * k;
               clamps[k] = {half_edges.data()[k],
                            conormal.data()[k] != 0,
                            at_rest.data()[k] != 0,
                            {v[0], v[1], v[2]},
                            angles.data()[k]};
               if (clamps[k].half_edge < 0 || clamps[k].half_edge >= (int)(3 * s.count()))
                 throw nb::value_error("clamps: half edge out of range");
             }
             s.elastic->set_clamps(clamps);
           })
      .def("energy",
           [](Model& s, Doubles u, Doubles phi) {
             double e[2];
             s.elastic->energy(s.state(u, phi), e);
             return Split(e[0], e[1]);
           })
      .def("gradient",
           [](Model& s, Doubles u, Doubles phi, Output g, Output edge_g) {
             double e[2];
             s.elastic->gradient(s.state(u, phi), e, sized(g, 3 * (size_t)s.mesh.vertices, "gradient"),
                                 sized(edge_g, s.mesh.edges, "edge gradient"));
             return Split(e[0], e[1]);
           })
      .def(
          "hessian",
          [](Model& s, Doubles u, Doubles phi, const std::string& kind, Scatter& scatter, double share) {
            if (kind != "exact" && kind != "safe" && kind != "mixed")
              throw nb::value_error("hessian: unknown kind");
            Hessian h = kind == "exact" ? Hessian::exact : (kind == "safe" ? Hessian::safe : Hessian::mixed);
            s.elastic->hessian(s.state(u, phi), h, share, scatter);
          },
          "u"_a, "phi"_a, "kind"_a, "scatter"_a, "share"_a = 1.0)
      .def("predict", [](Model& s, Doubles u, Doubles phi, Doubles du,
                         Doubles dphi) { s.elastic->predict(s.state(u, phi), s.state(du, dphi)); })
      .def("folds_over",
           [](Model& s, Doubles u, Doubles phi, Doubles moved_u, Doubles moved_phi) {
             return s.elastic->folds_over(s.state(u, phi), s.state(moved_u, moved_phi));
           })
      .def("fold_sides",
           [](Model& s, Doubles u, Doubles phi) {
             std::vector<int> sides(3 * s.count());
             s.elastic->fold_sides(s.state(u, phi), sides.data());
             return to_numpy(std::move(sides), {s.count(), 3});
           })
      .def("set_sides",
           [](Model& s, Ints sides) { s.elastic->set_sides(sized(sides, 3 * s.count(), "sides")); })
      .def("turn_gradient",
           [](Model& s, Doubles u, Doubles phi, Doubles weight, Output g) {
             s.elastic->turn_gradient(s.state(u, phi), sized(weight, 3 * s.count(), "weights"),
                                      sized(g, 3 * (size_t)s.mesh.vertices, "gradient"));
           })
      .def("mixed",
           [](Model& s, Doubles u, Doubles phi) {
             std::vector<double> a(36 * s.count()), b(18 * s.count()), c(3 * s.count());
             s.elastic->mixed(s.state(u, phi), a.data(), b.data(), c.data());
             return nb::make_tuple(to_numpy(std::move(a), {s.count(), 6, 6}),
                                   to_numpy(std::move(b), {s.count(), 6, 3}),
                                   to_numpy(std::move(c), {s.count(), 3}));
           })
      .def("mixed_along",
           [](Model& s, Doubles u, Doubles phi, Doubles rate) {
             std::vector<double> slope(6 * s.count());
             s.elastic->mixed_along(s.state(u, phi), sized(rate, slope.size(), "rate"), slope.data());
             return to_numpy(std::move(slope), {s.count(), 6});
           })
      .def("stresses",
           [](Model& s, Doubles u, Doubles phi) {
             std::vector<double> out(8 * s.count());
             s.elastic->stresses(s.state(u, phi), out.data());
             return to_numpy(std::move(out), {s.count(), 8});
           })
      .def("invariants_jacobian",
           [](Model& s, Doubles u, Doubles phi) {
             std::vector<double> j(126 * s.count());
             s.elastic->invariants_jacobian(s.state(u, phi), j.data());
             return to_numpy(std::move(j), {s.count(), 6, 21});
           })
      .def("rest_jacobian",
           [](Model& s) {
             std::vector<double> j(126 * s.count());
             s.elastic->rest_jacobian(j.data());
             return to_numpy(std::move(j), {s.count(), 6, 21});
           })
      .def("invariants", [](Model& s, Doubles u, Doubles phi) {
        std::vector<double> l(3 * s.count()), a(3 * s.count());
        s.elastic->invariants(s.state(u, phi), l.data(), a.data());
        return nb::make_tuple(to_numpy(std::move(l), {s.count(), 3}), to_numpy(std::move(a), {s.count(), 3}));
      });
}

static void bind_scatter(nb::module_& m) {
  nb::class_<Scatter>(m, "Scatter")
      .def(
          "__init__",
          [](Scatter* self, Model& model, bool edges, int owned, Ints start, Ints unknown, Doubles weight,
             int threads) {
            sized(start, 3 * (size_t)model.mesh.vertices + model.mesh.edges + 1, "constraint rows");
            sized(weight, unknown.size(), "constraint weights");
            Mesh mesh = model.mesh;
            if (!model.elastic->bends()) std::fill(mesh.across.begin(), mesh.across.end(), -1);  // no hinges
            new (self) Scatter(mesh, edges, owned, copied(start), copied(unknown), copied(weight), threads);
          },
          "model"_a, "edges"_a, "owned"_a, "start"_a, "unknown"_a, "weight"_a, "threads"_a = 1)
      .def_rw("adding", &Scatter::adding)
      .def("pattern",
           [](Scatter& s, Longs rank) {
             std::vector<int64_t> start;
             std::vector<int> column;
             s.pattern(rank.data(), start, column);
             size_t rows = start.size(), entries = column.size();
             return nb::make_tuple(to_numpy(std::move(start), {rows}),
                                   to_numpy(std::move(column), {entries}));
           })
      .def("add_vertices",
           [](Scatter& s, Ints vertices, Doubles blocks) {
             sized(blocks, 9 * vertices.size(), "vertex blocks");
             for (size_t k = 0; k < vertices.size(); ++k) {
               if (vertices.data()[k] < 0 || vertices.data()[k] >= s.vertices)
                 throw nb::value_error("vertex blocks: index out of range");
               s.add_vertex(vertices.data()[k], blocks.data() + 9 * k);
             }
           })
      .def("assemble",  // (m, 21, 21) blocks, not symmetric, in place of what was there
           [](Scatter& s, Doubles blocks) {
             sized(blocks, DOFS * (size_t)DOFS * s.count(), "triangle blocks");
             s.clear();
             for (int t = 0; t < s.count(); ++t) {
               s.open(t);
               s.add_square(t, blocks.data() + (size_t)DOFS * DOFS * t);
             }
           })
      // The arrays are written in place: the caller keeps them alive as long as the scatter.
      .def("bind",
           [](Scatter& s, Ints ai, Ints aj, Output av, Ints bi, Ints bj, Output bv, Ints ghost_columns) {
             sized(ai, (size_t)s.owned + 1, "rows");
             Rows inside{ai.data(), aj.data(), av.data()}, outside;
             if (bi.size() > 0) outside = {bi.data(), bj.data(), bv.data()};
             s.bind(inside, outside, copied(ghost_columns));
           });
}

static void bind_coarsen(nb::module_& m) {
  // (triangle, corner, rest_corner, home, weight, feature, kind, hang, hang_weight) of the coarse mesh
  m.def("coarsen", [](Ints corner, Ints rest_corner, Ints chart, Doubles start, Doubles rest, Ints support,
                      Ints group, Ints locked, Ints feature, Ints kind, Ints hang, Doubles hang_weight,
                      int target) {
    size_t triangles = chart.size(), vertices = support.size();
    auto indices = [](const Ints& array, size_t size, size_t count, const char* name) {
      std::span<const int> values(sized(array, size, name), size);
      for (int v : values)
        if (v < 0 || v >= (int)count) throw nb::value_error("coarsen: index out of range");
      return values;
    };
    FineMesh mesh{
        .corner = indices(corner, 3 * triangles, vertices, "corner"),
        .rest_corner = indices(rest_corner, 3 * triangles, rest.size() / 3, "rest_corner"),
        .chart = {chart.data(), triangles},
        .start = {sized(start, 3 * vertices, "start"), 3 * vertices},
        .rest = {rest.data(), rest.size()},
        .support = {support.data(), vertices},
        .group = indices(group, vertices, vertices, "group"),
        .locked = {sized(locked, vertices, "locked"), vertices},
        .feature = indices(feature, 2 * kind.size(), vertices, "feature"),
        .kind = {kind.data(), kind.size()},
        .hang = indices(hang, 3 * hang_weight.size(), vertices, "hang"),
        .hang_weight = {hang_weight.data(), hang_weight.size()},
    };
    CoarseMesh out = coarsen(mesh, target);
    size_t m = out.triangle.size(), f = out.kind.size(), k = out.hang_weight.size();
    return nb::make_tuple(to_numpy(std::move(out.triangle), {m}), to_numpy(std::move(out.corner), {m, 3}),
                          to_numpy(std::move(out.rest_corner), {m, 3}),
                          to_numpy(std::move(out.home), {vertices}),
                          to_numpy(std::move(out.weight), {vertices, 3}),
                          to_numpy(std::move(out.feature), {f, 2}), to_numpy(std::move(out.kind), {f}),
                          to_numpy(std::move(out.hang), {k, 3}), to_numpy(std::move(out.hang_weight), {k}));
  });
}

static void bind_proximity(nb::module_& m) {
  nb::class_<Proximity>(m, "Proximity")
      .def(
          "__init__",
          [](Proximity* self, Doubles points, Ints triangles, Ints edges) {
            for (const Ints& part : {triangles, edges})
              for (size_t i = 0; i < part.size(); ++i)
                if (part.data()[i] < 0 || (size_t)part.data()[i] >= points.size() / 3)
                  throw nb::value_error("Proximity: index out of range");
            new (self) Proximity({points.data(), points.size()}, copied(triangles), copied(edges));
          },
          "points"_a, "triangles"_a, "edges"_a)
      .def(
          "pairs",
          // (codes of faces, codes of edges), see proximity.hpp
          [](Proximity& self, Doubles x, Doubles moved, double reach) {
            const size_t size = 3 * (size_t)self.vertices();
            std::vector<int64_t> faces, edges;
            self.pairs(sized(x, size, "x"), sized(moved, size, "moved"), reach, faces, edges);
            const size_t f = faces.size(), e = edges.size();
            return nb::make_tuple(to_numpy(std::move(faces), {f}), to_numpy(std::move(edges), {e}));
          },
          "x"_a, "moved"_a, "reach"_a);
}

NB_MODULE(_kernels, m) {
  nb::set_leak_warnings(false);  // objects may outlive the interpreter through PETSc callbacks
  m.doc() = "Elastic energies of triangle meshes and their derivatives (C++).";
  m.def("instruction_set", &instruction_set,
        "Instruction set of the kernels in use: baseline, avx2 or avx512.");
  bind_model(m);
  bind_scatter(m);
  bind_coarsen(m);
  bind_proximity(m);
  m.def("add_pressure_hessian", [](Scatter& scatter, Ints corners, Doubles positions, Doubles factor) {
    const size_t count = corners.size() / 3;
    add_pressure_hessian(scatter, corners.data(), positions.data(), count, sized(factor, count, "factor"));
  });
}
