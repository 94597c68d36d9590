// Modal passes over a polarization under rising tension: one forms the sums that a step needs, one makes the step.
//
// In the coordinates xi, v of scaled_modes.hpp, r the rows of the ports: with f the forces of the linear connections
// without potentials, k what known forces add to v, h = w a / 2, and p_0, p_1 twice the weights of the middle of a step
// (ModalCoordinates in physics/coupling/potentials),
//     b = p_0 (2 xi + v) + p_1 r f + (p_1 - p_0) k,      g = 2 sqrt(kappa) q b,      q = h (1 - T h),
// and the modal force is r f+ - psi_m g, f+ the forces found. T is 0 but under extreme tensions (the guard of
// tonewood.physics.coupling.potentials.tension). g is a sum of a part without f and one for each force, so that all sums are
// known before the forces are.
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

// use(first mode, numbers, xi and v) of each Pack<2> of modes: two vectors at a time, so that their latencies overlap.
template <class Use>
inline void in_scaled_pairs(const Component& c, double* state, const Use& use) {
    const std::size_t n = c.n, step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
    const double* numbers = c.coordinates.numbers.data();
    for (std::size_t k = 0; k < n; k += kPadding, numbers += step, state += kScaledState * kPadding)
        for (int j = 0; j < kPadding; j += Pack<2>::size) use(k + j, numbers + j, state + j);
}

// Sums of a step as vectors, over b without f: q b v, (q b)^2, q b^2, and for each port r xi, r (xi + v), q p_1 r v,
// q r b, q^2 p_1 r b. `known`: (p_1 - p_0) k by mode, null without any.
template <bool Known>
inline void sum_tension_step(const Component& c, double* state, double T, const double* known, double* to) {
    by_ports(c.n_ports, [&]<int P>() {
        using V = Pack<2>;
        using S = Simd;
        const int n_ports = P < 0 ? c.n_ports : P;
        S::V all[kSharedSums] = {}, each[kMostPorts<P>][kPortSums] = {};
        in_scaled_pairs(c, state, [&](std::size_t k, const double* at, const double* x) {
            const V h = V::load(at), xi = V::load(x), v = V::load(x + kPadding), free = xi + v;
            V b = V::load(at + 4 * kPadding) * (xi + free);
            if constexpr (Known) b = b + V::load(known + k);
            const V q = neg_mul_add(h, h * T, h), qb = q * b, qv = q * v, qqb = q * qb, p1 = V::load(at + 5 * kPadding);
            add_products(all[0], b, qv);
            add_products(all[1], qb, qb);
            add_products(all[2], qb, b);
            for (int p = 0; p < n_ports; ++p) {
                const V r = V::load(at + (kScaledNumbers + p) * kPadding), moved = p1 * r;
                add_products(each[p][0], r, xi), add_products(each[p][1], r, free);
                add_products(each[p][2], moved, qv), add_products(each[p][3], r, qb);
                add_products(each[p][4], moved, qqb);
            }
        });
        double* out = to;
        for (int i = 0; i < kSharedSums; ++i, out += S::width) S::store(out, all[i]);
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i, out += S::width) S::store(out, each[p][i]);
    });
}

// What makes a step: T of the guard, 2 sqrt(kappa) psi_m, forces on the ports, alone and found, and `known` as above.
struct TensionMade {
    double guard = 0, tension = 0;
    const double* known = nullptr;
    const double *alone = nullptr, *found = nullptr;
};

// The state after a step to the displacements `next` under modal forces, at x.
inline void store_scaled(const double* at, double* x, const Pack<2>& next, const Pack<2>& modal, const Pack<2>& v) {
    using V = Pack<2>;
    next.store(x);
    neg_mul_add(V::load(at + 2 * kPadding), next,
                mul_add(V::load(at + 3 * kPadding), modal, V::load(at + kPadding) * v)).store(x + kPadding);
}

template <bool Known>
inline void make_tension_step(const Component& c, double* state, const TensionMade& made) {
    by_ports(c.n_ports, [&]<int P>() {
        using V = Pack<2>;
        const int n_ports = P < 0 ? c.n_ports : P;
        double alone[kMostPorts<P>], found[kMostPorts<P>];
        std::copy_n(made.alone, n_ports, alone), std::copy_n(made.found, n_ports, found);
        in_scaled_pairs(c, state, [&](std::size_t k, const double* at, double* x) {
            const V h = V::load(at), xi = V::load(x), v = V::load(x + kPadding), free = xi + v;
            V driven{}, modal{};
            for (int p = 0; p < n_ports; ++p) {
                const V r = V::load(at + (kScaledNumbers + p) * kPadding);
                driven = mul_add(r, alone[p], driven), modal = mul_add(r, found[p], modal);
            }
            V b = mul_add(V::load(at + 5 * kPadding), driven, V::load(at + 4 * kPadding) * (xi + free));
            if constexpr (Known) b = b + V::load(made.known + k);
            modal = mul_add(neg_mul_add(h, h * made.guard, h) * b, -made.tension, modal);
            store_scaled(at, x, free + modal, modal, v);
        });
    });
}

// Displacements of a contact port now and free of forces, and its displacement per mean psi over 2 sqrt(kappa), of the
// step that `begun` describes.
struct ContactSums {
    double now, free, reach;
};
inline ContactSums contact_sums(const Component& c, const double* state, int port, const TensionMade& begun) {
    using S = Simd;
    using V = S::V;
    const std::size_t n = c.n, step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
    const double *numbers = c.coordinates.numbers.data(), *row = c.contact.rows.data() + 2 * std::size_t(port) * n;
    const double* const root = c.coordinates.basis.data() + 3 * n;
    V here{}, later{}, moved{};
    for (std::size_t k = 0; k < n; k += kPadding, numbers += step, state += kScaledState * kPadding)
        for (int j = 0; j < kPadding; j += S::width) {
            const V h = S::load(numbers + j), xi = S::load(state + j), v = S::load(state + kPadding + j);
            const V r = S::load(row + k + j) * S::load(root + k + j);
            V driven{};
            for (int p = 0; p < c.n_ports; ++p)
                driven += S::load(numbers + (kScaledNumbers + p) * kPadding + j) * begun.alone[p];
            V b = S::load(numbers + 4 * kPadding + j) * (xi + xi + v) + S::load(numbers + 5 * kPadding + j) * driven;
            if (begun.known) b += S::load(begun.known + k + j);
            here += r * xi, later += r * (xi + v), moved += r * (h - h * (h * begun.guard)) * b;
        }
    return {S::sum(here), S::sum(later), S::sum(moved)};
}

}  // namespace
}  // namespace tonewood
