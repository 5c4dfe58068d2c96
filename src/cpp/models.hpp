// Elastic models: each is a scalar function of the six invariants of a triangle (design, section 1).
//
// To add a bending variant: one struct with f(sin alpha, cos alpha) and how to subtract its values without
// cancellation, and one line in the table of elastic.cpp.
// To add a material: one struct with stretching() (and bending() if it differs) and one line in that table.
#pragma once

#include "dual.hpp"

namespace voile {
inline namespace VOILE_ISA {

// l_i: squared edge lengths; s_i, c_i: sine and cosine of alpha_i = theta_i/2 + s_i phi_i.
template <class T>
struct Invariants {
  T l[3], s[3], c[3];
};

// How much more the invariants are than those of another shape, rounded in proportion to the difference; s_i,
// c_i: sine and cosine of the difference of the alpha_i.
template <class T>
struct Increase {
  T l[3], s[3], c[3];
};

// A woven fabric beside its Young's modulus and Poisson's ratio along the warp: the warp's direction in the
// basis of the rest edges from the first vertex (any length; it goes with the triangle where the rest shape
// changes), weft and shear modulus over young, and where `own` is 1 bending stiffnesses over young (m^3),
// else those of the thickness.
struct Weave {
  static constexpr int LENGTH = 9;
  Real c1, c2, weft, shear, own, bend11, bend12, bend22, bend66;
};

template <class T>
struct Fabric {
  T thickness, young, poisson;
  const Weave* weave = nullptr;
};

template <class T>
struct Sym2 {  // symmetric 2x2 [[a, b], [b, c]]
  T a, b, c;
  T det() const { return a * c - b * b; }
  Sym2 inverse() const {
    T i = T(1.0) / det();
    return {c * i, -(b * i), a * i};
  }
};

template <class T>
inline Sym2<Real> value(const Sym2<T>& m) {
  return {value(m.a), value(m.b), value(m.c)};
}

// First fundamental form in the basis of the edges from the first vertex; linear in the squared lengths.
template <class T>
inline Sym2<T> first_form(const T l[3]) {
  return {l[2], 0.5 * (l[1] + l[2] - l[0]), l[1]};
}

// det(first_form(l)) - det(first_form(l - dl)).
template <class T>
inline T det_increase(const T l[3], const T dl[3]) {
  T w[3], sum = T(0.0), increase = T(0.0);
  for (int i = 0; i < 3; ++i) w[i] = 2.0 * l[i] - dl[i], sum = sum + w[i];
  for (int i = 0; i < 3; ++i) increase = increase + dl[i] * (0.5 * sum - w[i]);
  return 0.5 * increase;
}

// Increase of twice the altitude on an edge, h, over that at rest; det_grown: of the first form's
// determinant.
VOILE_INLINE Real height_increase(const Real& h, const Real& h_rest, const Real& inverse_l, const Real& dl,
                                  const Real& det_grown) {
  return inverse_l * (Real(4.0) * det_grown - h_rest * h_rest * dl) / (h + h_rest);
}

// Second fundamental form in the same basis from II_i = 2 altitude_i f(alpha_i).
template <class T>
inline Sym2<T> second_form(const T ii[3]) {
  return {ii[0] + ii[1], ii[0], ii[0] + ii[2]};
}

// |M|^2 = lambda/2 tr(M)^2 + mu tr(M^2) for M = inverse * s, both symmetric.
template <class T>
inline T saint_venant(const Sym2<T>& inverse, const Sym2<T>& s, const T& lambda, const T& mu) {
  T m11 = inverse.a * s.a + inverse.b * s.b, m12 = inverse.a * s.b + inverse.b * s.c;
  T m21 = inverse.b * s.a + inverse.c * s.b, m22 = inverse.b * s.b + inverse.c * s.c;
  T trace = m11 + m22;
  return 0.5 * (lambda * trace * trace) + mu * (m11 * m11 + 2.0 * (m12 * m21) + m22 * m22);
}

// Plane-stress Lame constants: lambda = E nu/(1-nu^2), mu = E/(2(1+nu)).
template <class T>
inline T lame_lambda(const Fabric<T>& f) {
  return f.young * f.poisson / (T(1.0) - f.poisson * f.poisson);
}
template <class T>
inline T lame_mu(const Fabric<T>& f) {
  return 0.5 * (f.young / (T(1.0) + f.poisson));
}

// ---- bending variants: f of sin(alpha), cos(alpha); its increase over that at rest; whether it goes on
// through 180 degrees of a hinge ----

// What it takes to subtract f(alpha_rest) from f = f(alpha): sines and cosines of alpha, alpha_rest and their
// difference.
struct Turned {
  Real s, c, f, s_rest, c_rest, sine, cosine;
};

struct Sin {
  static constexpr bool directors = true, passes = true;
  template <class T>
  static T f(const T& s, const T&) {
    return s;
  }
  static Real increase(const Turned& t) {  // sums of cosines and sines as products
    return select(t.cosine.p > 0.0, t.sine * (t.c + t.c_rest) / (Real(1.0) + t.cosine), t.s - t.s_rest);
  }
};
struct Average : Sin {  // all director angles zero: the mid-edge normal bisects the two face normals
  static constexpr bool directors = false;
};
struct Tan {  // infinite at a fully folded hinge
  static constexpr bool directors = true, passes = false;
  template <class T>
  static T f(const T& s, const T& c) {
    return s / select(value(c).p > 0.0, c, T(0.0));
  }
  static Real increase(const Turned& t) { return t.sine / (select(t.c.p > 0.0, t.c, Real(0.0)) * t.c_rest); }
};
struct Theta {
  static constexpr bool directors = true, passes = true;
  template <class T>
  static T f(const T& s, const T& c) {
    return angle(s, c);
  }
  static Real increase(const Turned& t) {
    const double pi = M_PI;
    Real turn = angle(t.sine, t.cosine), missing = t.f - angle(t.s_rest, t.c_rest) - turn;  // whole turns
    return turn + select(missing.p > pi, Real(2.0 * pi), select(missing.p < -pi, Real(-2.0 * pi), Real(0.0)));
  }
};

// ---- materials: energies per unit rest area; dA = A - A_rest, dB = B - B_rest ----

struct StVK {
  template <class T>
  static T stretching(const Sym2<T>&, const Sym2<T>& da, const Sym2<T>& inverse, const Fabric<T>& f) {
    return 0.25 * (f.thickness * saint_venant(inverse, da, lame_lambda(f), lame_mu(f)));
  }
  template <class T>
  static T bending(const Sym2<T>&, const Sym2<T>&, const Sym2<T>& inverse, const Sym2<T>&, const Sym2<T>& db,
                   const Fabric<T>& f) {
    T cube = f.thickness * f.thickness * f.thickness;
    return (1.0 / 12.0) * (cube * saint_venant(inverse, db, lame_lambda(f), lame_mu(f)));
  }
};

// St. Venant-Kirchhoff, orthotropic about the weave's axes (Jones 1999, "Mechanics of Composite Materials",
// plane stress): twice the energies are s11 e11^2 + 2 s12 e11 e22 + s22 e22^2 + 4 s66 e12^2 of the Green
// strain, and the same with bending stiffnesses of the change of curvature.
struct Orthotropic {
  // Stiffnesses over Young's modulus and thickness.
  template <class T>
  struct Plane {
    T s11, s12, s22, s66;
    explicit Plane(const Fabric<T>& f) {
      T weft = lift<T>(f.weave->weft);
      s11 = T(1.0) / (T(1.0) - weft * f.poisson * f.poisson);
      s22 = weft * s11;
      s12 = f.poisson * s22;
      s66 = lift<T>(f.weave->shear);
    }
    Plane(const T& b11, const T& b12, const T& b22, const T& b66) : s11(b11), s12(b12), s22(b22), s66(b66) {}

    // Of a symmetric form v in the basis of the rest edges, whose first form has an inverse.
    T twice_energy(const Sym2<T>& v, const Sym2<T>& inverse, const Weave& w) const {
      Sym2<T> a = inverse.inverse();
      T c1 = lift<T>(w.c1), c2 = lift<T>(w.c2);
      T q1 = a.a * c1 + a.b * c2, q2 = a.b * c1 + a.c * c2, det = a.det();  // (-q2, q1) lies along the weft
      T length = c1 * q1 + c2 * q2;
      T e11 = (c1 * c1 * v.a + 2.0 * (c1 * c2 * v.b) + c2 * c2 * v.c) / length;
      T e22 = (q2 * q2 * v.a - 2.0 * (q1 * q2 * v.b) + q1 * q1 * v.c) / (det * length);
      T e12 = ((c1 * q1 - c2 * q2) * v.b + c2 * q1 * v.c - c1 * q2 * v.a) / (sqrt(det) * length);
      return s11 * e11 * e11 + 2.0 * (s12 * e11 * e22) + s22 * e22 * e22 + 4.0 * (s66 * e12 * e12);
    }
  };

  template <class T>
  static T stretching(const Sym2<T>&, const Sym2<T>& da, const Sym2<T>& inverse, const Fabric<T>& f) {
    return 0.125 * (f.thickness * f.young * Plane<T>(f).twice_energy(da, inverse, *f.weave));
  }
  template <class T>
  static T bending(const Sym2<T>&, const Sym2<T>&, const Sym2<T>& inverse, const Sym2<T>&, const Sym2<T>& db,
                   const Fabric<T>& f) {
    const Weave& w = *f.weave;
    T cube = (1.0 / 12.0) * (f.thickness * f.thickness * f.thickness);
    Plane<T> plane(f);
    auto own = w.own.p > 0.5;
    Plane<T> bend(
        select(own, lift<T>(w.bend11), cube * plane.s11), select(own, lift<T>(w.bend12), cube * plane.s12),
        select(own, lift<T>(w.bend22), cube * plane.s22), select(own, lift<T>(w.bend66), cube * plane.s66));
    return 0.5 * (f.young * bend.twice_energy(db, inverse, w));
  }
};

struct NeoHookean {
  template <class T>
  static T stretching(const Sym2<T>&, const Sym2<T>& da, const Sym2<T>& inverse, const Fabric<T>& f) {
    T trace = inverse.a * da.a + 2.0 * (inverse.b * da.b) + inverse.c * da.c;  // tr(A_rest^-1 A) - 2
    T det = inverse.det() * da.det();
    T growth = trace + det;         // J^2 - 1 = det(1 + A_rest^-1 dA) - 1
    T log_j = 0.5 * log1p(growth);  // trace - 2 ln J = growth - ln(1 + growth) - det
    return 0.5 * (f.thickness * (lame_mu(f) * (less_log1p(growth) - det) + lame_lambda(f) * log_j * log_j));
  }
  template <class T>
  static T bending(const Sym2<T>& a, const Sym2<T>& da, const Sym2<T>& inverse, const Sym2<T>& b_rest,
                   const Sym2<T>& db, const Fabric<T>& f) {
    Sym2<T> i = a.inverse(), b{b_rest.a + db.a, b_rest.b + db.b, b_rest.c + db.c};
    T m11 = i.a * b.a + i.b * b.b - inverse.a * b_rest.a - inverse.b * b_rest.b;
    T m12 = i.a * b.b + i.b * b.c - inverse.a * b_rest.b - inverse.b * b_rest.c;
    T m21 = i.b * b.a + i.c * b.b - inverse.b * b_rest.a - inverse.c * b_rest.b;
    T m22 = i.b * b.b + i.c * b.c - inverse.b * b_rest.b - inverse.c * b_rest.c;
    // Their values without cancellation: A^-1 (dB - dA R), R = A_rest^-1 B_rest.
    Sym2<Real> j = value(i), g = value(da), d = value(db), k = value(inverse), rest = value(b_rest);
    Real r11 = k.a * rest.a + k.b * rest.b, r12 = k.a * rest.b + k.b * rest.c;
    Real r21 = k.b * rest.a + k.c * rest.b, r22 = k.b * rest.b + k.c * rest.c;
    Real n11 = d.a - g.a * r11 - g.b * r21, n12 = d.b - g.a * r12 - g.b * r22;
    Real n21 = d.b - g.b * r11 - g.c * r21, n22 = d.c - g.b * r12 - g.c * r22;
    set_value(m11, j.a * n11 + j.b * n21), set_value(m12, j.a * n12 + j.b * n22);
    set_value(m21, j.b * n11 + j.c * n21), set_value(m22, j.b * n12 + j.c * n22);
    T trace = m11 + m22, cube = f.thickness * f.thickness * f.thickness;
    T norm =
        0.5 * (lame_lambda(f) * trace * trace) + lame_mu(f) * (m11 * m11 + 2.0 * (m12 * m21) + m22 * m22);
    return (1.0 / 12.0) * (cube * norm);
  }
};

// Relaxed St. Venant-Kirchhoff (tension field: Pipkin 1986, Steigmann 1990): with principal Green strains
// e1 >= e2, taut where e2 >= -nu e1 (both stresses tensile), wrinkled (uniaxial, E h e1^2/2) where only e1 >
// 0, slack (zero) where e1 <= 0. Areas J under `least` cost E h `hold` ln(J/least)^2: hinges beside a
// triangle without a height would turn about any axis (docs/kernels.md).
struct TensionField {
  static constexpr double least = 0.1, hold = 1e-5;
  template <class T>
  static T stretching(const Sym2<T>& a, const Sym2<T>& da, const Sym2<T>& inverse, const Fabric<T>& f) {
    T trace = inverse.a * da.a + 2.0 * (inverse.b * da.b) + inverse.c * da.c;  // 2 (e1 + e2)
    T det = inverse.det() * da.det();                                          // 4 e1 e2
    T disc = 0.25 * (trace * trace) - det;
    auto split = value(disc).p > 0.0;
    T root = select(split, sqrt(select(split, disc, T(1.0))), T(0.0));
    T e1 = 0.5 * (0.5 * trace + root), e2 = 0.5 * (0.5 * trace - root);
    T taut = StVK::stretching(a, da, inverse, f);
    T wrinkled = 0.5 * (f.thickness * f.young * e1 * e1);
    T margin1 = e1 + f.poisson * e2, margin2 = e2 + f.poisson * e1;
    T some = select(value(e1).p > 0.0, wrinkled, T(0.0));
    T field = select((value(margin2).p >= 0.0) & (value(margin1).p >= 0.0), taut, some);
    T growth = trace + det;  // J^2 - 1
    auto vanishes = value(growth).p < least * least - 1.0;
    T missing = 0.5 * log1p(select(vanishes, growth, T(0.0))) - std::log(least);
    return field + select(vanishes, hold * (f.thickness * f.young * missing * missing), T(0.0));
  }
  template <class T>
  static T bending(const Sym2<T>& a, const Sym2<T>& da, const Sym2<T>& inverse, const Sym2<T>& b_rest,
                   const Sym2<T>& db, const Fabric<T>& f) {
    return StVK::bending(a, da, inverse, b_rest, db, f);
  }
};

// ---- models: energy of one triangle, split into stretching and bending ----
// dl = l - l_rest; df = Fibre::f(alpha) - Fibre::f(alpha_rest), values only.

template <class T>
struct Energy {
  T stretching, bending;
};

template <class Material>
struct Membrane {
  static constexpr bool bends = false, directors = false, woven = std::is_same_v<Material, Orthotropic>,
                        quadratic = woven || std::is_same_v<Material, StVK>, biot = false;
  using Fibre = Average;
  template <class T>
  static Energy<T> energy(const Invariants<T>& q, const T dl[3], const Real[3], const Invariants<T>& r,
                          const Fabric<T>& f) {
    Sym2<T> rest = first_form(r.l);
    T area = 0.5 * sqrt(rest.det());
    return {area * Material::stretching(first_form(q.l), first_form(dl), rest.inverse(), f), T(0.0)};
  }
};

template <class Bending, class Material>
struct Koiter {
  static constexpr bool bends = true, directors = Bending::directors,
                        woven = std::is_same_v<Material, Orthotropic>,
                        quadratic = woven || std::is_same_v<Material, StVK>, biot = false;
  using Fibre = Bending;
  template <class T>
  static Energy<T> energy(const Invariants<T>& q, const T dl[3], const Real df[3], const Invariants<T>& r,
                          const Fabric<T>& f) {
    Sym2<T> a = first_form(q.l), da = first_form(dl), rest = first_form(r.l), inverse = rest.inverse();
    T det = a.det(), det_rest = rest.det(), area = 0.5 * sqrt(det_rest);
    T ii_rest[3], increase[3];
    Real l[3], grown[3];
    for (int i = 0; i < 3; ++i) l[i] = value(q.l[i]), grown[i] = value(dl[i]);
    Real det_grown = det_increase(l, grown);
    for (int i = 0; i < 3; ++i) {
      T height = 2.0 * sqrt(det / q.l[i]), height_rest = 2.0 * sqrt(det_rest / r.l[i]);
      T f_rest = Bending::f(r.s[i], r.c[i]);
      ii_rest[i] = height_rest * f_rest;
      increase[i] = height * Bending::f(q.s[i], q.c[i]) - ii_rest[i];
      Real h = value(height), h_rest = value(height_rest);
      set_value(increase[i], h * df[i] + height_increase(h, h_rest, Real(1.0) / l[i], grown[i], det_grown) *
                                             value(f_rest));
    }
    T bending = Material::bending(a, da, inverse, second_form(ii_rest), second_form(increase), f);
    return {area * Material::stretching(a, da, inverse, f), area * bending};
  }
};

// Discrete Shells (Grinspun et al. 2003): lengths, area, hinge angles. The stiffnesses are those that give
// the isotropic plate on an equilateral mesh: bending D/6 per hinge side |e|^2/altitude weight, lengths 4/3
// mu, area (lambda - mu)/2 (not negative: the hinge and spring terms alone have Poisson's ratio 1/3).
struct DiscreteShells {
  static constexpr bool bends = true, directors = false, woven = false, quadratic = false, biot = false;
  using Fibre = Theta;
  template <class T>
  static Energy<T> energy(const Invariants<T>& q, const T dl[3], const Real df[3], const Invariants<T>& r,
                          const Fabric<T>& f) {
    T det = first_form(q.l).det(), det_rest = first_form(r.l).det(), area = 0.5 * sqrt(det_rest);
    T lambda = lame_lambda(f), mu = lame_mu(f);
    T lengths = T(0.0), hinges = T(0.0);
    for (int i = 0; i < 3; ++i) {
      T root = sqrt(r.l[i]);
      T strain = dl[i] / (root * (sqrt(q.l[i]) + root));  // |e|/|e_rest| - 1
      lengths = lengths + strain * strain;
      T fold = 2.0 * (angle(q.s[i], q.c[i]) - angle(r.s[i], r.c[i]));
      set_value(fold, Real(2.0) * df[i]);
      hinges = hinges + (r.l[i] / sqrt(det_rest)) * fold * fold;  // |e|/altitude
    }
    T growth = det_increase(q.l, dl) / (det_rest + sqrt(det * det_rest));  // area over area at rest, - 1
    T rest_of_area = 0.5 * (lambda - mu);
    rest_of_area = select(value(rest_of_area).p > 0.0, rest_of_area, T(0.0));
    T cube = f.thickness * f.thickness * f.thickness;
    T flexural = f.young * cube / (12.0 * (T(1.0) - f.poisson * f.poisson));
    T stretching = area * f.thickness * ((4.0 / 3.0) * (mu * lengths) + rest_of_area * growth * growth);
    return {stretching, 0.25 * (flexural * hinges)};
  }
};

// Projective Dynamics (Bouaziz et al. 2014) with the quadratic-distance energies of a Koiter shell.
// Stretching is quadratic in Biot's strain U - I: h (mu |U - I|^2 + lambda/2 tr(U - I)^2), where |U - I| = |F
// - R| and tr U - 2 is sqrt 2 times the distance to the deformations of zero mean strain. Bending is Koiter's
// with II_i = altitude_i (nu_i + nu'_i) in place of 2 altitude_i sin(alpha_i) times the hinge's normal: nu
// and nu' are the unit outward conormals on both sides of edge i, altitudes those at rest, and vectors are
// compared with those at rest in the triangle's own frame. Where edges keep their lengths and the rest shape
// is flat that is quadratic in the positions (isometric bending, Bergou et al. 2006).
struct Projective {
  static constexpr bool bends = true, directors = false, woven = false, quadratic = false, biot = true;
  using Fibre = Average;

  // tr(U) - 2 and det(U - I) of d = tr(C) - 2 and q = det(C - I), C = U^2, without cancellation.
  template <class T>
  struct Strain {
    T trace, det;
    Strain(const T& d, const T& q) {
      T j = sqrt(T(1.0) + d + q), grown = (d + q) / (T(1.0) + j), s = sqrt(T(4.0) + d + 2.0 * grown);
      trace = (d + 2.0 * grown) / (s + T(2.0));
      det = q * s / ((s + T(2.0)) * (T(1.0) + j) + d);
    }
  };

  template <class T>
  static Energy<T> energy(const Invariants<T>& q, const T dl[3], const Real[3], const Invariants<T>& r,
                          const Fabric<T>& f) {
    Sym2<T> da = first_form(dl), rest = first_form(r.l), inverse = rest.inverse();
    T det_rest = rest.det(), area = 0.5 * sqrt(det_rest), along[3], out[2][3];
    for (int i = 0; i < 3; ++i) {
      T height = 2.0 * sqrt(det_rest / r.l[i]);
      along[i] = height * (q.s[i] * q.c[i] - r.s[i] * r.c[i]);
      T across = height * (q.s[i] * q.s[i] - r.s[i] * r.s[i]);  // along nu_i, whose components follow
      T x = i == 0 ? T(0.0) - inverse.a - inverse.b : i == 1 ? inverse.a : inverse.b;
      T y = (i == 1 ? T(0.0) : i == 0 ? T(-1.0) : T(1.0)) * sqrt(inverse.det());
      T root = 0.5 * height * across / sqrt(inverse.a);
      out[0][i] = root * x, out[1][i] = root * y;
    }
    Strain<T> e(inverse.a * da.a + 2.0 * (inverse.b * da.b) + inverse.c * da.c, inverse.det() * da.det());
    T mu = lame_mu(f);
    T stretching = (mu + 0.5 * lame_lambda(f)) * e.trace * e.trace - 2.0 * (mu * e.det);
    T bending = T(0.0);
    for (const T* part : {along, out[0], out[1]})
      bending = bending + StVK::bending(rest, rest, inverse, rest, second_form(part), f);
    return {area * f.thickness * stretching, area * bending};
  }
};

}  // namespace VOILE_ISA
}  // namespace voile
