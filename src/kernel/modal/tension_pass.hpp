// Modal passes over a component under rising tension, one for each sample: a pass finishes the step before and sums what
// the next one needs.
//
// In the coordinates xi, v of scaled_modes.hpp, r the rows of the ports: with h = half and s = 1 / (1 + h T),
//     U = (2 xi + v) s,     D = (2 xi + v + r f) s,     push p = r f - h T D,
// U is xi + xi+ without port forces, D with them. About the tension T of a pass, with after = U - xi and m = h s,
//     port displacement       sum r after - tau sum r m U + tau^2 sum r m^2 U,
//     S+                      2 sum h after^2 - 4 tau sum h m U after + 2 tau^2 sum h m^2 (U^2 + 2 U after)
//                             + 4 f (sum r m after - tau sum r m^2 (U + after)) + f^2 R,   R = -2 dZ/dT,
// Z(T) = sum r^2 s the port's compliance: tensions near T need no other pass.
#pragma once

#include <algorithm>
#include <cmath>

#include "pass.hpp"
#include "scaled_modes.hpp"

namespace tonewood {
namespace {

// A force on modes for a sample: on a port, by its row.
struct Load {
    const double* row;
    double force;
};

struct PassInput {
    double made = 0;      // tension of the step to finish
    const double* forces = nullptr;       // on the ports in it
    const Load* loads = nullptr;          // on other ports
    int n_loads = 0;
    double tried = 0;     // tension of the sums
    const Input* inputs = nullptr;        // known inputs in the samples `made_in` and `begun`
    int n_inputs = 0, made_in = 0, begun = 0;
    // destinations of the sums, a vector each, and strides of the same string or port; `first`: the shared sums are set
    double *shared = nullptr, *own = nullptr;
    std::size_t next_shared = 0, next_own = 0, next_port = 0;
    bool first = false;
};

// s is known at a tension within kExpansion of that of the step to finish, and within kNear of that of the sums.
constexpr int kNewtons = 2;  // Newton corrections of a reciprocal; each squares its error
constexpr double kNear = 2e-4;

// relative change of a mode's stiffness up to which three terms of an expansion describe a step
constexpr double kExpansion = 3e-5;

// `state` (ScaledModes) holds s of the tension of the last pass.
// Sums as vectors: h xi^2, h after^2, h m U after, h m^2 U^2, h m^2 U after, and for each port r xi, r after, r m U,
// r m after, r m^2 U, r m^2 after.
template <int P, bool Make, bool Begin, bool Plain>
void tension_pass(const Component& c, double* state, const PassInput& v) {
    using V = Pack<2>;  // two vectors at a time: their latencies overlap
    using S = Simd;
    constexpr int kMost = P < 0 ? kMaxTensionPorts : (P > 0 ? P : 1);
    const int n_ports = P < 0 ? c.n_ports : P;
    const std::size_t n = c.n, step = std::size_t(kScaledNumbers + n_ports) * kPadding;
    const double *const numbers = c.tension.numbers.data(), *const basis = c.tension.basis.data();
    const double made = v.made, tried = v.tried;
    double force[kMost] = {};
    if constexpr (Make)
        for (int p = 0; p < n_ports; ++p) force[p] = v.forces[p];
    S::V all[kSharedSums] = {}, each[kMost][kPortSums] = {};
    // adds known inputs (x, y) of a sample to xi, and to v what does not follow from that
    const auto input = [&](std::size_t k, int sample, V& to_xi, V& to_v) {
        for (int j = 0; j < v.n_inputs; ++j) {
            const double value = v.inputs[j].values[sample * v.inputs[j].stride];
            const V x = V::load(v.inputs[j].vector + k) * value, y = V::load(v.inputs[j].vector + n + k) * value;
            to_xi = to_xi + V::load(basis + k) * x;
            to_v = to_v + V::load(basis + 6 * n + k) * x + V::load(basis + 7 * n + k) * y;
        }
    };
    const auto make_step = [&](std::size_t k, const double* at, double* to) {
        const V h = V::load(at);
        V xi = V::load(to), up = V::load(to + kPadding), s = V::load(to + 2 * kPadding);
        V u = xi + up, push{}, given{};
        for (int p = 0; p < n_ports; ++p) push = push + V::load(at + (kScaledNumbers + p) * kPadding) * force[p];
        if constexpr (!Plain) {
            input(k, v.made_in, u, given);
            V pushed{};
            for (int l = 0; l < v.n_loads; ++l) pushed = pushed + V::load(v.loads[l].row + k) * v.loads[l].force;
            push = push + V::load(basis + 3 * n + k) * pushed;
        }
        const V rise = h * made, off = (1.0 - s) - rise * s;
        s = s + s * (off + off * off);
        push = push - rise * ((xi + u + push) * s);
        xi = u + push;
        up = V::load(at + kPadding) * up + V::load(at + 3 * kPadding) * push - V::load(at + 2 * kPadding) * xi;
        if constexpr (!Plain) up = up + given;
        xi.store(to), up.store(to + kPadding), s.store(to + 2 * kPadding);
    };
    const auto begin_step = [&](std::size_t k, const double* at, double* to) {
        const V h = V::load(at), xi = V::load(to);
        V both = xi * 2.0 + V::load(to + kPadding), s = V::load(to + 2 * kPadding);
        if constexpr (!Plain) {
            V unused{};
            input(k, v.begun, both, unused);
        }
        const V stiff = h * tried + 1.0;
        for (int i = 0; i < kNewtons; ++i) s = s + s * (1.0 - stiff * s);
        s.store(to + 2 * kPadding);
        const V U = both * s, after = U - xi, m = h * s, mU = m * U, mz = m * after, hq = h * mU;
        add_products(all[0], h * xi, xi);
        add_products(all[1], h * after, after);
        add_products(all[2], hq, after);
        add_products(all[3], hq, mU);
        add_products(all[4], hq, mz);
        for (int p = 0; p < n_ports; ++p) {
            const V r = V::load(at + (kScaledNumbers + p) * kPadding), rm = r * m;
            add_products(each[p][0], r, xi), add_products(each[p][1], r, after);
            add_products(each[p][2], r, mU), add_products(each[p][3], r, mz);
            add_products(each[p][4], rm, mU), add_products(each[p][5], rm, mz);
        }
    };
    // the sums of a pack follow one pack behind its step, so that neither waits for the other
    constexpr std::size_t paces = kPadding / V::size;
    const std::size_t count = n / V::size;
    const auto place = [&](std::size_t i, const auto& use) {
        const std::size_t group = i / paces, j = i % paces * V::size;
        use(i * V::size, numbers + group * step + j, state + group * kScaledState * kPadding + j);
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
        for (int i = 0; i < kSharedSums; ++i) {
            double* const to = v.shared + i * v.next_shared;
            S::store(to, v.first ? all[i] : S::load(to) + all[i]);
        }
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i) S::store(v.own + p * v.next_port + i * v.next_own, each[p][i]);
    }
}

template <bool Make, bool Begin, bool Plain>
void tension_pass(const Component& c, double* state, const PassInput& v) {
    switch (c.n_ports) {
        case 0: return tension_pass<0, Make, Begin, Plain>(c, state, v);
        case 1: return tension_pass<1, Make, Begin, Plain>(c, state, v);
        case 2: return tension_pass<2, Make, Begin, Plain>(c, state, v);
        default: return tension_pass<-1, Make, Begin, Plain>(c, state, v);
    }
}

// Taylor coefficients of the compliance between two ports of a component about the tension `at`, the first one less the
// compliance at rest.
void compliances(const Component& c, double at, int p, int q, double* out) {
    const std::size_t n = c.n;
    const double *to = c.rows.data() + 2 * std::size_t(p) * n, *from = c.rows.data() + 2 * std::size_t(q) * n;
    std::fill_n(out, kTaylor, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double gain = c.tension.gain[k], half = c.tension.half[k];
        const double s = 1.0 / (1.0 + half * at);
        double term = to[k] * from[k] * gain * s;
        out[0] -= term * half * at;
        for (int j = 1; j < kTaylor; ++j) out[j] += term *= -half * s;
    }
}

}  // namespace
}  // namespace tonewood
