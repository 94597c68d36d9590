// Modal passes over a polarization under rising tension, one for each sample: a pass finishes the step before and forms
// the sums that the next one needs.
//
// In the coordinates xi, v of scaled_modes.hpp, r the rows of the ports: with h = half, b = 2 xi + v + r f, f the forces
// of the linear connections without tensions, and q = h (1 - h T) at the tension T counted on,
//     g = 2 sqrt(kappa) q b,      modal force p = r f+ - psi_m g,      f+ the forces found.
// g is a sum of a part without f and one for each force, so that all sums are known before the forces are.
#pragma once

#include "pass.hpp"
#include "scaled_modes.hpp"

namespace tonewood {
namespace {

// Numbers that finish a step: its tension counted on, 2 sqrt(kappa) psi_m, and forces on the ports, alone and found.
struct TensionMade {
    double ahead = 0, tension = 0;
    const double *alone = nullptr, *found = nullptr;
};

// Sums as vectors, over b = 2 xi + v: q b v, (q b)^2, q b^2, and for each port r xi, r (xi + v), q r v, q r b, q^2 r b.
// `ahead` is the tension counted on.
template <int P, bool Make, bool Begin>
void tension_pass(const Component& c, double* state, const TensionMade& made, double ahead, double* to) {
    using V = Pack<2>;  // two vectors at a time: their latencies overlap
    using S = Simd;
    constexpr int kMost = P < 0 ? kMaxTensionPorts : (P > 0 ? P : 1);
    const int n_ports = P < 0 ? c.n_ports : P;
    const std::size_t n = c.n, step = std::size_t(kScaledNumbers + n_ports) * kPadding;
    const double* const numbers = c.tension.numbers.data();
    double alone[kMost] = {}, found[kMost] = {};
    if constexpr (Make)
        for (int p = 0; p < n_ports; ++p) alone[p] = made.alone[p], found[p] = made.found[p];
    S::V all[kSharedSums] = {}, each[kMost][kPortSums] = {};
    const auto make_step = [&](const double* at, double* x) {
        const V h = V::load(at), xi = V::load(x), v = V::load(x + kPadding), free = xi + v;
        V b = xi + free, modal{};
        for (int p = 0; p < n_ports; ++p) {
            const V r = V::load(at + (kScaledNumbers + p) * kPadding);
            b = mul_add(r, alone[p], b), modal = mul_add(r, found[p], modal);
        }
        modal = mul_add(neg_mul_add(h, h * made.ahead, h) * b, -made.tension, modal);
        const V next = free + modal;
        next.store(x);
        neg_mul_add(V::load(at + 2 * kPadding), next,
                    mul_add(V::load(at + 3 * kPadding), modal, V::load(at + kPadding) * v)).store(x + kPadding);
    };
    const auto begin_step = [&](const double* at, const double* x) {
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
    };
    // the sums of a pack follow one pack behind its step, so that neither waits for the other
    constexpr std::size_t paces = kPadding / V::size;
    const std::size_t count = n / V::size;
    const auto place = [&](std::size_t i, const auto& use) {
        const std::size_t group = i / paces, j = i % paces * V::size;
        use(numbers + group * step + j, state + group * kScaledState * kPadding + j);
    };
    if constexpr (Make && Begin) {
        place(0, make_step);
        for (std::size_t i = 1; i < count; ++i) place(i, make_step), place(i - 1, begin_step);
        place(count - 1, begin_step);
    } else {
        for (std::size_t i = 0; i < count; ++i) {
            if constexpr (Make) place(i, make_step);
            if constexpr (Begin) place(i, begin_step);
        }
    }
    if constexpr (Begin) {
        for (int i = 0; i < kSharedSums; ++i, to += S::width) S::store(to, all[i]);
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i, to += S::width) S::store(to, each[p][i]);
    }
}

template <bool Make, bool Begin>
void tension_pass(const Component& c, double* state, const TensionMade& made, double ahead, double* to) {
    switch (c.n_ports) {
        case 0: return tension_pass<0, Make, Begin>(c, state, made, ahead, to);
        case 1: return tension_pass<1, Make, Begin>(c, state, made, ahead, to);
        case 2: return tension_pass<2, Make, Begin>(c, state, made, ahead, to);
        default: return tension_pass<-1, Make, Begin>(c, state, made, ahead, to);
    }
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
    const double *numbers = c.tension.numbers.data(), *row = c.contact.rows.data() + 2 * std::size_t(port) * n;
    const double* const root = c.tension.basis.data() + 3 * n;
    V here{}, later{}, moved{};
    for (std::size_t k = 0; k < n; k += kPadding, numbers += step, state += kScaledState * kPadding)
        for (int j = 0; j < kPadding; j += S::width) {
            const V h = S::load(numbers + j), xi = S::load(state + j), v = S::load(state + kPadding + j);
            const V r = S::load(row + k + j) * S::load(root + k + j);
            V b = xi + xi + v;
            for (int p = 0; p < c.n_ports; ++p) b += S::load(numbers + (kScaledNumbers + p) * kPadding + j) * begun.alone[p];
            here += r * xi, later += r * (xi + v), moved += r * (h - h * (h * begun.ahead)) * b;
        }
    return {S::sum(here), S::sum(later), S::sum(moved)};
}

}  // namespace
}  // namespace tonewood
