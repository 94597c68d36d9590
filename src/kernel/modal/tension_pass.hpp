// Modal passes over a polarization under rising tension: one forms the sums that a step needs, one makes the step.
//
// In the coordinates xi, v of scaled_modes.hpp, r the rows of the ports: with h = half, b = 2 xi + v + r f, f the
// forces of the linear connections without tensions, and q = h (1 - h T) at the tension T counted on,
//     g = 2 sqrt(kappa) q b,      modal force p = r f+ - psi_m g,      f+ the forces found.
// g is a sum of a part without f and one for each force, so that all sums are known before the forces are.
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

// Sums of a step as vectors, over b = 2 xi + v: q b v, (q b)^2, q b^2, and for each port r xi, r (xi + v), q r v, q r
// b, q^2 r b. `ahead` is the tension counted on.
inline void sum_tension_step(const Component& c, double* state, double ahead, double* to) {
    by_ports(c.n_ports, [&]<int P>() {
        using V = Pack<2>;
        using S = Simd;
        const int n_ports = P < 0 ? c.n_ports : P;
        S::V all[kSharedSums] = {}, each[kMostPorts<P>][kPortSums] = {};
        in_scaled_pairs(c, state, [&](std::size_t, const double* at, const double* x) {
            const V h = V::load(at), xi = V::load(x), v = V::load(x + kPadding), free = xi + v, b = xi + free;
            const V q = neg_mul_add(h, h * ahead, h), qb = q * b, qv = q * v, qqb = q * qb;
            add_products(all[0], b, qv);
            add_products(all[1], qb, qb);
            add_products(all[2], qb, b);
            for (int p = 0; p < n_ports; ++p) {
                const V r = V::load(at + (kScaledNumbers + p) * kPadding);
                add_products(each[p][0], r, xi), add_products(each[p][1], r, free);
                add_products(each[p][2], r, qv), add_products(each[p][3], r, qb);
                add_products(each[p][4], r, qqb);
            }
        });
        double* out = to;
        for (int i = 0; i < kSharedSums; ++i, out += S::width) S::store(out, all[i]);
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i, out += S::width) S::store(out, each[p][i]);
    });
}

// Numbers that make a step: its tension counted on, 2 sqrt(kappa) psi_m, and forces on the ports, alone and found.
struct TensionMade {
    double ahead = 0, tension = 0;
    const double *alone = nullptr, *found = nullptr;
};

// The state after a step to the displacements `next` under modal forces, at x.
inline void store_scaled(const double* at, double* x, const Pack<2>& next, const Pack<2>& modal, const Pack<2>& v) {
    using V = Pack<2>;
    next.store(x);
    neg_mul_add(V::load(at + 2 * kPadding), next,
                mul_add(V::load(at + 3 * kPadding), modal, V::load(at + kPadding) * v)).store(x + kPadding);
}

inline void make_tension_step(const Component& c, double* state, const TensionMade& made) {
    by_ports(c.n_ports, [&]<int P>() {
        using V = Pack<2>;
        const int n_ports = P < 0 ? c.n_ports : P;
        double alone[kMostPorts<P>], found[kMostPorts<P>];
        std::copy_n(made.alone, n_ports, alone), std::copy_n(made.found, n_ports, found);
        in_scaled_pairs(c, state, [&](std::size_t, const double* at, double* x) {
            const V h = V::load(at), xi = V::load(x), v = V::load(x + kPadding), free = xi + v;
            V b = xi + free, modal{};
            for (int p = 0; p < n_ports; ++p) {
                const V r = V::load(at + (kScaledNumbers + p) * kPadding);
                b = mul_add(r, alone[p], b), modal = mul_add(r, found[p], modal);
            }
            modal = mul_add(neg_mul_add(h, h * made.ahead, h) * b, -made.tension, modal);
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
            V b = xi + xi + v;
            for (int p = 0; p < c.n_ports; ++p)
                b += S::load(numbers + (kScaledNumbers + p) * kPadding + j) * begun.alone[p];
            here += r * xi, later += r * (xi + v), moved += r * (h - h * (h * begun.ahead)) * b;
        }
    return {S::sum(here), S::sum(later), S::sum(moved)};
}

}  // namespace
}  // namespace tonewood
