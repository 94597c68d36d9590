// Modal passes over a polarization under rising tension: sums that a step needs, and the step itself.
//
// In the coordinates xi, v of scaled_modes.hpp, r the rows of the ports: with f the forces of the linear connections
// without potentials, k what known forces add to v, h = w a / 2, and p_0, p_1 twice the weights of the middle of a step
// (ModalCoordinates in physics/coupling/potentials),
//     b = p_0 (2 xi + v) + p_1 r f + (p_1 - p_0) k,      g = 2 sqrt(kappa) q b,      q = h (1 - T h),
// and the modal force is r f+ - psi_m g, f+ the forces found. T is 0 but under extreme tensions (the guard of
// tonewood.physics.coupling.potentials.tension). g is a sum of a part without f and one for each force, so that all sums are
// known before the forces are. A plain step has T = 0 and k = 0: h p_0 and h p_1 are all that it needs of h, p_0, p_1.
#pragma once

#include "pass.hpp"
#include "scaled_modes.hpp"

namespace tonewood {
namespace {

// use<P>() for P ports, -1 for more than two.
template <class Use>
inline void by_ports(int n_ports, const Use& use) {
    switch (n_ports) {
        case 0: return use.template operator()<0>();
        case 1: return use.template operator()<1>();
        case 2: return use.template operator()<2>();
        default: return use.template operator()<-1>();
    }
}

template <int P>
constexpr int kMostPorts = P < 0 ? kMaxScaledPorts : P > 0 ? P : 1;

// use<V>(first mode, numbers, xi and v) of each pack V of modes: two vectors at a time, so that their latencies
// overlap, and one where the last modes need no more.
template <class Use>
inline void in_scaled_packs(const Component& c, double* state, const Use& use) {
    using V = Pack<2>;
    const std::size_t n = c.coordinates.n, step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
    const double* numbers = c.coordinates.numbers.data();
    std::size_t k = 0;
    const auto apply = [&]<class W>() {
        const std::size_t group = k / kPadding, j = k % kPadding;
        use.template operator()<W>(k, numbers + group * step + j, state + group * kScaledState * kPadding + j);
    };
    for (; k + Simd::width < n; k += V::size) apply.template operator()<V>();
    if (k < n) apply.template operator()<Pack<1>>();
}

// One step of a string: T of the guard, 2 sqrt(kappa) psi_m, (p_1 - p_0) k by mode, null without known forces; forces
// on the ports, alone and found.
struct TensionStep {
    double guard = 0, tension = 0;
    const double* known = nullptr;
    const double *alone = nullptr, *found = nullptr;
    bool plain() const { return guard == 0.0 && !known; }
};

// q b without f of modes from the k-th on, and q p_1: c = 2 xi + v.
template <class V>
struct Direction {
    V alone, per_force;
};
template <bool Plain, class V>
inline Direction<V> direction(const Component& component, const TensionStep& step, std::size_t k, const double* at,
                              const V& c) {
    if constexpr (Plain) {
        return {V::load(at) * c, V::load(at + kPadding)};
    } else {
        const Coordinates& s = component.coordinates;
        const V h = V::load(s.half.data() + k), q = neg_mul_add(h, h * step.guard, h);
        V b = V::load(s.middle.data() + k) * (c + c);
        if (step.known) b = b + V::load(step.known + k);
        return {q * b, q * V::load(s.middle.data() + component.n + k) * 2.0};
    }
}

// v after a step to the displacements `next` under modal forces.
template <class V>
inline V scaled_velocity(const double* at, const V& next, const V& modal, const V& v) {
    return neg_mul_add(V::load(at + 3 * kPadding), next,
                       mul_add(V::load(at + 4 * kPadding), modal, V::load(at + 2 * kPadding) * v));
}

// Ports' forces of a step that is made.
template <int P>
struct PortForcesOf {
    const int n_ports;
    double alone[kMostPorts<P>], found[kMostPorts<P>];
    PortForcesOf(const Component& c, const TensionStep& made) : n_ports(P < 0 ? c.n_ports : P) {
        std::copy_n(made.alone, n_ports, alone), std::copy_n(made.found, n_ports, found);
    }
};

// Makes a step of modes from the k-th on: xi and v after it.
template <bool Plain, int P, class V>
inline void make_modes(const Component& c, const TensionStep& made, const PortForcesOf<P>& by, std::size_t k,
                       const double* at, V& xi, V& v) {
    const int n_ports = P < 0 ? by.n_ports : P;
    const V free = xi + v;
    V driven{}, modal{};
    for (int p = 0; p < n_ports; ++p) {
        const V r = V::load(at + (kScaledNumbers + p) * kPadding);
        driven = mul_add(r, by.alone[p], driven), modal = mul_add(r, by.found[p], modal);
    }
    const Direction<V> g = direction<Plain>(c, made, k, at, xi + free);
    modal = mul_add(mul_add(g.per_force, driven, g.alone), -made.tension, modal);
    xi = free + modal;
    v = scaled_velocity(at, xi, modal, v);
}

// Sums of a step as vectors, over b without f: q b v, (q b)^2, q b c of a plain step and q b^2 of another one, and for
// each port r xi, r (xi + v), q p_1 r v, q r b, q^2 p_1 r b.
template <int P>
struct TensionSums {
    using S = Simd;
    const int n_ports;
    S::V all[kSharedSums] = {}, each[kMostPorts<P>][kPortSums] = {};

    explicit TensionSums(const Component& c) : n_ports(P < 0 ? c.n_ports : P) {}

    template <bool Plain, class V>
    void add(const Component& c, const TensionStep& begun, std::size_t k, const double* at, const V& xi, const V& v) {
        const V free = xi + v, twice = xi + free;
        const Direction<V> g = direction<Plain>(c, begun, k, at, twice);
        add_products(all[0], g.alone, v);
        add_products(all[1], g.alone, g.alone);
        if constexpr (Plain) {
            add_products(all[2], g.alone, twice);
        } else {
            V b = V::load(c.coordinates.middle.data() + k) * (twice + twice);
            if (begun.known) b = b + V::load(begun.known + k);
            add_products(all[2], g.alone, b);
        }
        for (int p = 0; p < (P < 0 ? n_ports : P); ++p) {
            const V r = V::load(at + (kScaledNumbers + p) * kPadding), moved = g.per_force * r;
            add_products(each[p][0], r, xi), add_products(each[p][1], r, free);
            add_products(each[p][2], moved, v), add_products(each[p][3], r, g.alone);
            add_products(each[p][4], moved, g.alone);
        }
    }
    void store(double* to) const {
        for (int i = 0; i < kSharedSums; ++i, to += S::width) S::store(to, all[i]);
        for (int p = 0; p < (P < 0 ? n_ports : P); ++p)
            for (int i = 0; i < kPortSums; ++i, to += S::width) S::store(to, each[p][i]);
    }
};

inline void make_tension_step(const Component& c, double* state, const TensionStep& made) {
    const auto make = [&]<bool Plain, int P>() {
        const PortForcesOf<P> by(c, made);
        in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, double* x) {
            V xi = V::load(x), v = V::load(x + kPadding);
            make_modes<Plain, P>(c, made, by, k, at, xi, v);
            xi.store(x), v.store(x + kPadding);
        });
    };
    by_ports(c.n_ports, [&]<int P>() {
        made.plain() ? make.template operator()<true, P>() : make.template operator()<false, P>();
    });
}

inline void sum_tension_step(const Component& c, double* state, const TensionStep& begun, double* to) {
    const auto sum = [&]<bool Plain, int P>() {
        TensionSums<P> sums(c);
        in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, const double* x) {
            sums.template add<Plain>(c, begun, k, at, V::load(x), V::load(x + kPadding));
        });
        sums.store(to);
    };
    by_ports(c.n_ports, [&]<int P>() {
        begun.plain() ? sum.template operator()<true, P>() : sum.template operator()<false, P>();
    });
}

// Makes a step and sums the next one, both plain.
inline void advance_tension(const Component& c, double* state, const TensionStep& made, double* to) {
    by_ports(c.n_ports, [&]<int P>() {
        const PortForcesOf<P> by(c, made);
        TensionSums<P> sums(c);
        in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, double* x) {
            V xi = V::load(x), v = V::load(x + kPadding);
            make_modes<true, P>(c, made, by, k, at, xi, v);
            sums.template add<true>(c, made, k, at, xi, v);
            xi.store(x), v.store(x + kPadding);
        });
        sums.store(to);
    });
}

// Displacements of a contact port now and free of forces, and its displacement per mean psi over 2 sqrt(kappa), of the
// step that `begun` describes.
struct ContactSums {
    double now, free, reach;
};
template <bool Plain>
inline ContactSums contact_sums(const Component& c, double* state, int port, const TensionStep& begun) {
    using S = Simd;
    const double *const row = c.contact.rows.data() + 2 * std::size_t(port) * c.n,
                 *const root = c.coordinates.basis.data() + 3 * c.n;
    S::V here{}, later{}, moved{};
    in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, const double* x) {
        const V xi = V::load(x), free = xi + V::load(x + kPadding), r = V::load(row + k) * V::load(root + k);
        V driven{};
        for (int p = 0; p < c.n_ports; ++p)
            driven = mul_add(V::load(at + (kScaledNumbers + p) * kPadding), begun.alone[p], driven);
        const Direction<V> g = direction<Plain>(c, begun, k, at, xi + free);
        add_products(here, r, xi), add_products(later, r, free);
        add_products(moved, r, mul_add(g.per_force, driven, g.alone));
    });
    return {S::sum(here), S::sum(later), S::sum(moved)};
}

}  // namespace
}  // namespace tonewood
