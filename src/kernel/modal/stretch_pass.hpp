// Modal passes over a component of a string with longitudinal motion, in the coordinates of scaled_modes.hpp: one sums
// the displacements of the ports now and free of forces, one makes the step.
#pragma once

#include "tension_pass.hpp"

namespace tonewood {
namespace {

inline void sum_stretch_step(const Component& c, double* state, double* to) {
    by_ports(c.n_ports, [&]<int P>() {
        const int n_ports = P < 0 ? c.n_ports : P;
        Simd::V each[kMostPorts<P>][2] = {};
        in_scaled_packs(c, state, [&]<class V>(std::size_t, const double* at, const double* x) {
            const V xi = V::load(x), free = xi + V::load(x + kPadding);
            for (int p = 0; p < n_ports; ++p) {
                const V r = V::load(at + (kScaledNumbers + p) * kPadding);
                add_products(each[p][0], r, xi), add_products(each[p][1], r, free);
            }
        });
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < 2; ++i) Simd::store(to + (kSharedSums + p * kPortSums + i) * Simd::width, each[p][i]);
    });
}

// Under forces `found` on the ports and `modal` on the lowest n modes (a multiple of kPadding), scaled as xi is.
inline void make_stretch_step(const Component& c, double* state, const double* found, const double* modal,
                              std::size_t n) {
    by_ports(c.n_ports, [&]<int P>() {
        const int n_ports = P < 0 ? c.n_ports : P;
        in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, double* x) {
            const V xi = V::load(x), v = V::load(x + kPadding);
            V force = k < n ? V::load(modal + k) : V{};
            for (int p = 0; p < n_ports; ++p)
                force = mul_add(V::load(at + (kScaledNumbers + p) * kPadding), found[p], force);
            const V next = xi + v + force;
            next.store(x), scaled_velocity(at, next, force, v).store(x + kPadding);
        });
    });
}

}  // namespace
}  // namespace tonewood
