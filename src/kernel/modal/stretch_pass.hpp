// Modal passes over a component of a string with longitudinal motion, one for each sample, in the coordinates of
// scaled_modes.hpp: a pass finishes the step before, under port forces and modal forces of the lowest modes, and sums the
// displacements of the ports now and free of forces.
#pragma once

#include "tension_pass.hpp"

namespace tonewood {
namespace {

// Forces that finish a step: on the ports; on the lowest `n` modes (a multiple of kPadding), scaled as xi is.
struct StretchMade {
    const double *found = nullptr, *modal = nullptr;
    std::size_t n = 0;
};

template <int P, bool Make, bool Begin>
void stretch_pass(const Component& c, double* state, const StretchMade& made, double* to) {
    using V = Pack<2>;  // two vectors at a time: their latencies overlap
    using S = Simd;
    constexpr int kMost = P < 0 ? kMaxTensionPorts : (P > 0 ? P : 1);
    const int n_ports = P < 0 ? c.n_ports : P;
    const std::size_t n = c.n, step = std::size_t(kScaledNumbers + n_ports) * kPadding;
    const double* numbers = c.tension.numbers.data();
    S::V each[kMost][2] = {};
    for (std::size_t k = 0; k < n; k += kPadding, numbers += step, state += kScaledState * kPadding)
        for (int j = 0; j < kPadding; j += V::size) {
            const double* const at = numbers + j;
            double* const x = state + j;
            V xi = V::load(x), v = V::load(x + kPadding);
            if constexpr (Make) {
                V modal = k < made.n ? V::load(made.modal + k + j) : V{};
                for (int p = 0; p < n_ports; ++p) modal = mul_add(V::load(at + (kScaledNumbers + p) * kPadding), made.found[p], modal);
                xi = xi + v + modal;
                v = neg_mul_add(V::load(at + 2 * kPadding), xi,
                                mul_add(V::load(at + 3 * kPadding), modal, V::load(at + kPadding) * v));
                xi.store(x), v.store(x + kPadding);
            }
            if constexpr (Begin)
                for (int p = 0; p < n_ports; ++p) {
                    const V r = V::load(at + (kScaledNumbers + p) * kPadding);
                    add_products(each[p][0], r, xi), add_products(each[p][1], r, xi + v);
                }
        }
    if constexpr (Begin)
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < 2; ++i) S::store(to + (kSharedSums + p * kPortSums + i) * S::width, each[p][i]);
}

template <bool Make, bool Begin>
void stretch_pass(const Component& c, double* state, const StretchMade& made, double* to) {
    switch (c.n_ports) {
        case 0: return stretch_pass<0, Make, Begin>(c, state, made, to);
        case 1: return stretch_pass<1, Make, Begin>(c, state, made, to);
        case 2: return stretch_pass<2, Make, Begin>(c, state, made, to);
        default: return stretch_pass<-1, Make, Begin>(c, state, made, to);
    }
}

}  // namespace
}  // namespace tonewood
