// The only assembly loops, for all models; compiled once per instruction set (VOILE_LANES, VOILE_ISA).
#include "elastic.hpp"

#include <map>
#include <optional>
#include <stdexcept>
#include <string>

#include "assembly.hpp"
#include "folds.hpp"
#include "sensitivities.hpp"
#include "team.hpp"

namespace voile {
inline namespace VOILE_ISA {

template <class Model>
class ElasticModel final : public Elastic {
  static constexpr bool by_hand = Model::quadratic || Model::biot;
  Mesh mesh;
  std::vector<Block> blocks;
  std::vector<int> clamp_of, rest_clamp_of;  // (3m) index into clamps, -1; empty without clamps (at rest)
  std::vector<Clamp> clamps;
  std::vector<Real> weight;  // per block, 0 in lanes without a triangle
  std::vector<double> turn_weight;
  std::vector<Rest> rest;
  std::vector<RestOf<Model>> quadratic;
  std::vector<Weave> weaves;  // per block; empty unless woven
  std::vector<Origin> origin;
  std::vector<Turn> turns;  // from the clamps that are at rest; empty without
  std::vector<Block> rest_blocks;
  std::vector<double> rest_points, still;  // still: no displacement
  bool rest_flat = false;
  std::vector<int> sides;                                   // (3m) of half edges; empty: all 0
  std::vector<double> predicted_tension, predicted_moment;  // (3m) dW/dl, dW/dalpha extrapolated by predict()

  // Values of a (3m) array for corner or edge i.
  static Real at_half(const Block& k, const std::vector<double>& values, int i) {
    return gather([&](int lane) { return values[3 * (k.first + std::min(lane, k.count - 1)) + i]; });
  }

  Local local(const Block& block, State state) const {
    Local w = local_shape<Model::bends>(block, mesh.start.data(), state.displacement);
    if constexpr (Model::bends) {
      if (!clamp_of.empty()) hold_directors(block, clamp_of, clamps, w);
      measure<true>(origin[block.first / LANES], w);
      if (!turns.empty()) turn_back(turns[block.first / LANES], w.q);
      if constexpr (Model::directors)
        for (int i = 0; i < 3; ++i) turn_director(block, i, state.director, w);
    } else {
      measure<false>(origin[block.first / LANES], w);
    }
    return w;
  }

  Local rest_local(size_t b) const {
    return local_shape<Model::bends>(rest_blocks[b], rest_points.data(), still.data());
  }

  // Half the angle of the rest shape to clamps at rest is alpha's there, the other half is taken off alpha:
  // as at a hinge, whatever the clamp's own direction.
  void share_turns(size_t b, Local& w) {
    Invariants<Real> free = w.q;
    hold_directors(rest_blocks[b], rest_clamp_of, clamps, w);
    for (int i = 0; i < 3; ++i) {
      Real c = sqrt(Real(0.5) + Real(0.5) * w.q.c[i]), s = (Real(0.5) * w.q.s[i]) / c;
      Turn& turn = turns[b];
      for (int lane = 0; lane < LANES; ++lane) {
        bool on = lane < blocks[b].count && rest_clamp_of[3 * (blocks[b].first + lane) + i] >= 0;
        turn.share[i].p[lane] = on ? 0.5 : 0.0;
        turn.s[i].p[lane] = on ? s[lane] : 0.0, turn.c[i].p[lane] = on ? c[lane] : 1.0;
        w.q.s[i].p[lane] = on ? s[lane] : free.s[i][lane], w.q.c[i].p[lane] = on ? c[lane] : free.c[i][lane];
      }
    }
  }

  // From the start shape with directors along the normals to the rest shape, which is known.
  void set_origin(size_t b) {
    Local w = local_shape<Model::bends>(blocks[b], mesh.start.data(), still.data());
    if constexpr (Model::bends) {
      if (!clamp_of.empty()) hold_directors(blocks[b], clamp_of, clamps, w);
      if (!turns.empty()) turn_back(turns[b], w.q);
    }
    for (int i = 0; i < 3; ++i) {
      origin[b].t[i] = half_tangent(w.q.s[i], w.q.c[i]);
      origin[b].root[i] = w.t.root[i];
      origin[b].t_rest[i] = half_tangent(rest[b].q.s[i], rest[b].q.c[i]);
      origin[b].dl[i] = w.q.l[i] - rest[b].q.l[i];
    }
  }

  // Share of the rest shape's turn about edge i that acts on q, not on q_rest.
  Real turned(size_t b, int i) const { return turns.empty() ? Real(0.0) : turns[b].share[i]; }

  // Blocks in which the half edges of clamp_of turn with their own triangle alone.
  std::vector<Block> clamped_blocks(const int* corner, const std::vector<int>& clamp_of) const {
    auto made = make_blocks(mesh, corner);
    for (size_t half = 0; half < clamp_of.size(); ++half) {
      int t = (int)half / 3, i = (int)half % 3;
      if (clamp_of[half] >= 0) made[t / LANES].own[i][t % LANES] = 1.0f;
    }
    return made;
  }

  template <int order>
  void evaluate(size_t b, const Local& w, Jet& jet) const {
    if constexpr (Model::quadratic)
      evaluate_quadratic<Model, order>(quadratic[b], w, jet);
    else if constexpr (Model::biot)
      evaluate_biot<Model, order>(quadratic[b], w, jet);
    else
      evaluate_automatic<Model, order>(rest[b], w.q, w.over, jet);
  }

  // Upper blocks of the Hessians of a block's triangles.
  void block_hessian(size_t b, State state, Hessian kind, double share, Real* out) const {
    const bool safe = kind == Hessian::safe, mixed = kind == Hessian::mixed;
    const Real exact = safe ? 1.0 - share : 1.0;
    const Block& block = blocks[b];
    Jet jet;
    Local w = local(block, state);
    evaluate<2>(b, w, jet);
    Real tension[3];
    for (int i = 0; i < 3; ++i) tension[i] = mixed ? at_half(block, predicted_tension, i) : jet.g[i];
    if (safe) make_safe<Model::bends ? 6 : 3>(w.t.e, share, jet, tension);
    std::optional<FoldHessian> folds;
    if constexpr (Model::bends)
      if (!safe || share < 1.0) {
        Real own[3], other[3];
        for (int i = 0; i < 3; ++i) {
          Real moment = mixed ? at_half(block, predicted_moment, i) : exact * jet.g[3 + i];
          own[i] = w.own[i] * moment, other[i] = w.other[i] * moment;
          if (!turn_weight.empty()) own[i] += exact * at_half(block, turn_weight, i);
        }
        folds.emplace(w, own, other);
      }
    fill_blocks<Model>(block, w, jet.h, tension, folds ? &*folds : nullptr, out);
  }

 public:
  explicit ElasticModel(Mesh m) : mesh(std::move(m)), blocks(make_blocks(mesh, mesh.corner.data())) {
    rest.resize(blocks.size());
    origin.resize(blocks.size());
    quadratic.resize(by_hand ? blocks.size() : 0);
    weaves.resize(Model::woven ? blocks.size() : 0);
    set_weave(nullptr);
    set_weights(std::vector<double>(mesh.triangles, 1.0).data());
  }

  bool bends() const override { return Model::bends; }
  bool directors() const override { return Model::directors; }

  void set_clamps(const std::vector<Clamp>& list) override {
    clamps = list;
    bool any_at_rest = std::any_of(list.begin(), list.end(), [](const Clamp& k) { return k.at_rest; });
    clamp_of.assign(list.empty() ? 0 : 3 * (size_t)mesh.triangles, -1);
    rest_clamp_of.assign(any_at_rest ? clamp_of.size() : 0, -1);
    for (size_t k = 0; k < clamps.size(); ++k) {
      clamp_of[clamps[k].half_edge] = (int)k;
      if (clamps[k].at_rest) rest_clamp_of[clamps[k].half_edge] = (int)k;
    }
    blocks = clamped_blocks(mesh.corner.data(), clamp_of);
    mark_sides(sides, blocks);
  }

  void set_rest(const double* points, const int* corners, bool flat) override {
    int count = mesh.triangles ? 1 + *std::max_element(corners, corners + 3 * (size_t)mesh.triangles) : 0;
    rest_points.assign(points, points + 3 * (size_t)count);
    still.assign(std::max(rest_points.size(), mesh.start.size()), 0.0);
    rest_blocks = clamped_blocks(corners, rest_clamp_of);
    rest_flat = flat;
    turns.resize(flat || rest_clamp_of.empty() ? 0 : blocks.size());
    for (size_t b = 0; b < blocks.size(); ++b) {
      Local w = rest_local(b);
      if (!turns.empty()) share_turns(b, w);
      rest[b].q = w.q;
      for (int i = 0; i < 3 && flat; ++i) rest[b].q.s[i] = 0.0, rest[b].q.c[i] = 1.0;
      set_origin(b);
      if constexpr (by_hand) quadratic[b] = quadratic_rest<Model>(rest[b]);
    }
  }

  void set_fabric(const double* thickness, const double* young, const double* poisson) override {
    for (size_t b = 0; b < blocks.size(); ++b) {
      auto per_triangle = [&](const double* values) {
        return gather(
            [&](int lane) { return values[blocks[b].first + std::min(lane, blocks[b].count - 1)]; });
      };
      rest[b].fabric = {per_triangle(thickness), per_triangle(young), per_triangle(poisson),
                        weaves.empty() ? nullptr : &weaves[b]};
      if constexpr (by_hand) quadratic[b] = quadratic_rest<Model>(rest[b]);
    }
  }

  void set_weave(const double* weave) override {
    static const double plain[Weave::LENGTH] = {1.0, 0.0, 1.0, 0.5};  // isotropic for poisson = 0
    for (size_t b = 0; b < weaves.size(); ++b) {
      auto number = [&](int k) {
        return gather([&](int lane) {
          const size_t t = (size_t)blocks[b].first + std::min(lane, blocks[b].count - 1);
          return weave ? weave[Weave::LENGTH * t + k] : plain[k];
        });
      };
      weaves[b] = {number(0), number(1), number(2), number(3), number(4),
                   number(5), number(6), number(7), number(8)};
      rest[b].fabric.weave = &weaves[b];
      if constexpr (by_hand)
        if (weave) quadratic[b] = quadratic_rest<Model>(rest[b]);
    }
  }

  void set_weights(const double* w) override {
    weight.assign(blocks.size(), Real(0.0));
    for (int t = 0; t < mesh.triangles; ++t) weight[t / LANES].p[t % LANES] = w[t];
  }
  void set_turn_weights(const double* w) override { turn_weight.assign(w, w + 3 * (size_t)mesh.triangles); }

  void energy(State state, double* split) override {
    Sum sum;
    Jet jet;
    for (size_t b = 0; b < blocks.size(); ++b) {
      evaluate<0>(b, local(blocks[b], state), jet);
      sum.add(jet, weight[b]);
    }
    sum.store(split);
  }

  void gradient(State state, double* split, double* gradient, double* edge_gradient) override {
    Sum sum;
    Jet jet;
    for (size_t b = 0; b < blocks.size(); ++b) {
      Local w = local(blocks[b], state);
      evaluate<1>(b, w, jet);
      sum.add(jet, weight[b]);
      add_gradient<Model>(blocks[b], w, jet, gradient, edge_gradient);
    }
    sum.store(split);
  }

  void hessian(State state, Hessian kind, double share, Scatter& scatter) override {
    if (kind == Hessian::mixed && predicted_tension.empty())
      throw std::logic_error("hessian: nothing was predicted");
    scatter.clear();
    Team(scatter.parts).share(scatter.parts, [&](int mine) {
      alignas(64) Real out[BLOCKS_LENGTH];
      std::fill(out, out + BLOCKS_LENGTH, Real(0.0));
      for (size_t b = 0; b < blocks.size(); ++b) {
        const int first = blocks[b].first, end = first + blocks[b].count;
        if (!scatter.visits(mine, first, end)) continue;
        for (int t = first; t < end; ++t) scatter.open(t, mine);
        block_hessian(b, state, kind, share, out);
        for (int t = first; t < end; ++t)
          scatter.add<LANES>(t, reinterpret_cast<const double*>(out), t - first, mine);
      }
    });
  }

  void predict(State state, State direction) override {
    predicted_tension.assign(3 * (size_t)mesh.triangles, 0.0);
    predicted_moment.assign(3 * (size_t)mesh.triangles, 0.0);
    Jet jet;
    for (size_t b = 0; b < blocks.size(); ++b) {
      const Block& block = blocks[b];
      Local w = local(block, state);
      evaluate<2>(b, w, jet);
      Vec3 own[3][3], across[3], d[3];
      if constexpr (Model::bends) alpha_gradient(w, own, across);
      for (int j = 0; j < 3; ++j) d[j] = gather_point(direction.displacement, block.corner[j]);
      Real rate[6];  // of q along the direction
      for (int i = 0; i < 3; ++i) {
        rate[i] = Real(2.0) * dot(w.t.e[i], d[(i + 2) % 3] - d[(i + 1) % 3]);
        rate[3 + i] = 0.0;
        if constexpr (Model::bends) {
          rate[3 + i] = dot(across[i], gather_point(direction.displacement, block.across[i]));
          for (int j = 0; j < 3; ++j) rate[3 + i] += dot(own[i][j], d[j]);
          if constexpr (Model::directors)
            rate[3 + i] += widen(block.sign[i]) *
                           gather([&](int lane) { return direction.director[block.edge[i][lane]]; });
        }
      }
      for (int i = 0; i < 6; ++i) {
        Real stress = jet.g[i];
        for (int j = 0; j < 6; ++j) stress += jet.h[upper(i, j)] * rate[j];
        for (int lane = 0; lane < block.count; ++lane)
          (i < 3 ? predicted_tension : predicted_moment)[3 * (block.first + lane) + i % 3] = stress[lane];
      }
    }
  }

  void turn_gradient(State state, const double* turn, double* gradient) override {
    for (const Block& block : blocks) {
      const double* turned = turn + 3 * (size_t)block.first;
      if (std::all_of(turned, turned + 3 * block.count, [](double v) { return v == 0.0; })) continue;
      Local w = local_shape<false>(block, mesh.start.data(), state.displacement);
      for (int lane = 0; lane < block.count; ++lane)
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j)
            add_lane(gradient + block.corner[j][lane], (Real(turned[3 * lane + i]) * w.t.c[i][j]) * w.t.n,
                     lane);
    }
  }

  void mixed(State state, double* q_rest, double* q_fabric, double* fabric) override {
    for (size_t b = 0; b < blocks.size(); ++b) {
      const Real on[3] = {turned(b, 0), turned(b, 1), turned(b, 2)};
      store_mixed<Model>(blocks[b], local(blocks[b], state), rest[b], on, q_rest, q_fabric, fabric);
    }
  }

  void mixed_along(State state, const double* rate, double* slope) override {
    for (size_t b = 0; b < blocks.size(); ++b) {
      const Real on[3] = {turned(b, 0), turned(b, 1), turned(b, 2)};
      store_mixed_along<Model>(blocks[b], local(blocks[b], state), rest[b], on, rate, slope);
    }
  }

  void stresses(State state, double* out) override {
    for (size_t b = 0; b < blocks.size(); ++b)
      store_stresses<Model>(blocks[b], local(blocks[b], state), rest[b], out);
  }

  void invariants_jacobian(State state, double* jacobian) override {
    for (const Block& block : blocks)
      store_jacobian<Model>(block, local(block, state), true, Model::directors, jacobian);
  }

  void rest_jacobian(double* jacobian) override {
    for (size_t b = 0; b < blocks.size(); ++b)
      store_jacobian<Model>(rest_blocks[b], rest_local(b), !rest_flat, false, jacobian);
  }

  void set_sides(const int* given) override {
    sides.assign(given, given + 3 * (size_t)mesh.triangles);
    mark_sides(sides, blocks);
  }

  void fold_sides(State state, int* out) override {
    std::fill(out, out + 3 * (size_t)mesh.triangles, 0);
    if constexpr (Model::bends && Model::Fibre::passes) {
      for (const Block& block : blocks)
        store_sides(block, local_shape<true>(block, mesh.start.data(), state.displacement), out);
      for (size_t half = 0; half < mesh.across.size();
           ++half)  // at 180 degrees round-off may tell them apart
        if (mesh.across[half] >= 0 && mesh.across[half] < (int)half) out[half] = out[mesh.across[half]];
    }
  }

  bool folds_over(State before, State after) override {
    if constexpr (Model::bends)
      for (const Block& block : blocks)
        if (turns_through(block, local(block, before), local(block, after))) return true;
    return false;
  }

  void invariants(State state, double* lengths, double* angles) override {
    for (const Block& block : blocks) {
      Local w = local(block, state);
      for (int lane = 0; lane < block.count; ++lane)
        for (int i = 0; i < 3; ++i) {
          lengths[3 * ((size_t)block.first + lane) + i] = w.q.l[i][lane];
          angles[3 * ((size_t)block.first + lane) + i] = std::atan2(w.q.s[i][lane], w.q.c[i][lane]);
        }
    }
  }
};

using Maker = std::unique_ptr<Elastic> (*)(Mesh);
template <class Model>
std::unique_ptr<Elastic> make(Mesh mesh) {
  return std::make_unique<ElasticModel<Model>>(std::move(mesh));
}

template <class Material>
void add_material(std::map<std::string, Maker>& table, const std::string& material) {
  table["koiter/average/" + material] = make<Koiter<Average, Material>>;
  table["koiter/sin/" + material] = make<Koiter<Sin, Material>>;
  table["koiter/tan/" + material] = make<Koiter<Tan, Material>>;
  table["koiter/theta/" + material] = make<Koiter<Theta, Material>>;
  table["membrane//" + material] = make<Membrane<Material>>;
}

std::unique_ptr<Elastic> make_elastic(const std::string& name, Mesh mesh) {
  static const auto table = [] {
    std::map<std::string, Maker> t;
    add_material<StVK>(t, "stvk");
    add_material<Orthotropic>(t, "orthotropic");
    add_material<NeoHookean>(t, "neo-hookean");
    add_material<TensionField>(t, "tension-field");
    t["discrete-shells//"] = make<DiscreteShells>;
    t["projective//"] = make<Projective>;
    return t;
  }();
  auto found = table.find(name);
  if (found == table.end()) throw std::invalid_argument("no elastic model " + name);
  return found->second(std::move(mesh));
}

}  // namespace VOILE_ISA
}  // namespace voile
