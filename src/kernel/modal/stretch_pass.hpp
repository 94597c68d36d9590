// Modal passes over a component of a string with longitudinal motion, in the coordinates of scaled_modes.hpp: one sums
// the displacements of the ports now and free of forces, one makes the step.
#pragma once

#include "tension_pass.hpp"

namespace tonewood {
namespace {

// Displacements of the ports now and free of forces, as vectors.
template <int P>
struct PortSums {
    const int n_ports;
    Simd::V each[kMostPorts<P>][2] = {};

    explicit PortSums(const Component& c) : n_ports(P < 0 ? c.n_ports : P) {}

    template <class V>
    void add(const double* at, const V& xi, const V& v) {
        const V free = xi + v;
        for (int p = 0; p < (P < 0 ? n_ports : P); ++p) {
            const V r = V::load(at + (kScaledNumbers + p) * kPadding);
            add_products(each[p][0], r, xi), add_products(each[p][1], r, free);
        }
    }
    void store(double* to) const {
        for (int p = 0; p < (P < 0 ? n_ports : P); ++p)
            for (int i = 0; i < 2; ++i) Simd::store(to + (kSharedSums + p * kPortSums + i) * Simd::width, each[p][i]);
    }
};

inline void sum_stretch_step(const Component& c, double* state, double* to) {
    by_ports(c.n_ports, [&]<int P>() {
        PortSums<P> sums(c);
        in_scaled_packs(c, state, [&]<class V>(std::size_t, const double* at, const double* x) {
            sums.add(at, V::load(x), V::load(x + kPadding));
        });
        sums.store(to);
    });
}

// Makes a step under forces `found` on the ports and `size` times `direction` on the lowest n modes (a multiple of
// kPadding), scaled as xi is; the sums of the next step go to `to` unless it is null.
inline void make_stretch_step(const Component& c, double* state, const double* found, const double* direction,
                              std::size_t n, double size, double* to) {
    const auto make = [&]<int P, bool Sums>() {
        PortSums<P> sums(c);
        in_scaled_packs(c, state, [&]<class V>(std::size_t k, const double* at, double* x) {
            const V xi = V::load(x), v = V::load(x + kPadding);
            V force = k < n ? V::load(direction + k) * size : V{};
            for (int p = 0; p < (P < 0 ? c.n_ports : P); ++p)
                force = mul_add(V::load(at + (kScaledNumbers + p) * kPadding), found[p], force);
            const V next = xi + v + force, later = scaled_velocity(at, next, force, v);
            next.store(x), later.store(x + kPadding);
            if constexpr (Sums) sums.add(at, next, later);
        });
        if constexpr (Sums) sums.store(to);
    };
    by_ports(c.n_ports, [&]<int P>() {
        to ? make.template operator()<P, true>() : make.template operator()<P, false>();
    });
}

}  // namespace
}  // namespace tonewood
