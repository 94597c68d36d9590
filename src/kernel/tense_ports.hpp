// Visits to the modes of a stretched component, one for each sample: the step that is due is made, and what the next one
// takes is summed on the same way.
//
// Everything is in the first numbers x of the modes and the rows r of the ports. With g = gain, a = weight, both of T-free
// motion x_u, and s = 1 / (1 + g a T / 2):
//     U = (x_u + x) s,     D = (x_u + x + g r f) s,     x+ = x_u + g (r f - a T D / 2),
// U being x + x+ without port forces, D with them. About the tension T of a visit, with m = a g s,
//     port displacement       sum r (U - x) - tau/2 sum r m U + tau^2/4 sum r m^2 U,
//     S+                      sum a (U - x)^2 - tau sum a m U (U - x)
//                             + f (2 sum r m (U - x) - tau sum r m^2 (2 U - x)) + f^2 R,   R = -2 dZ/dT,
// Z(T) = sum r^2 g s the port's compliance: tensions near T need no other visit.
#pragma once

#include <algorithm>
#include <cmath>

#include "sweep.hpp"

namespace tonewood {
namespace {

// A force on modes for a sample: of a port by its row, or a known one by what it adds to the state.
template <class T>
struct Load {
    const T* row;
    T force;
};

template <class T>
struct Visit {
    double made = 0;      // tension of the step to make
    const T* forces = nullptr;            // on the ports in it
    const Load<T>* loads = nullptr;       // other ports pushed in it
    int n_loads = 0;
    double tried = 0;     // tension that sums are taken at
    const Input<T>* inputs = nullptr;     // known inputs, those of sample `made_in` and those of sample `begun`
    int n_inputs = 0, made_in = 0, begun = 0;
};

constexpr int kNewtons = 2;  // corrections of a reciprocal: its error is squared in each
template <class T>
constexpr double kNear = sizeof(T) == sizeof(double) ? 2e-4 : 2e-2;  // and was at most this

// `kept` (n): s of the last tension that a visit ended with, which must be near.
// `shared` and `own`: sums as vectors, added to; of the string x a x, y a y (y = U - x), U a m y, a m^2 (U^2 + x^2), and
// for each port r x, r U, r m x, r m U, r m^2 x, r m^2 U.
template <class T, int P, bool Make, bool Begin, bool Plain>
void visit(const Component<T>& c, T* sx, T* sy, T* kept, const Visit<T>& v, T* shared, T* own) {
    using S = Simd<T>;
    using V = typename S::V;
    constexpr int kMost = P < 0 ? kMaxStretchedPorts : (P > 0 ? P : 1);
    const int n_ports = P < 0 ? c.n_ports : P;
    const std::size_t n = c.n;
    const T *const e = c.e.data(), *const weights = c.stretched.weight.data(), *const gains = c.stretched.gain.data();
    const T* const rows = c.rows.data();
    const T half_made = T(0.5 * v.made), half_tried = T(0.5 * v.tried);
    T force[kMost] = {};
    if constexpr (Make)
        for (int p = 0; p < n_ports; ++p) force[p] = v.forces[p];
    V all[kSharedSums], each[kMost][kPortSums];
    if constexpr (Begin) {
        for (int i = 0; i < kSharedSums; ++i) all[i] = S::load(shared + i * S::width);
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i) each[p][i] = V{};
    }
    for (std::size_t k = 0; k < n; k += S::width) {
        const V a = S::load(weights + k), gain = S::load(gains + k), e00 = S::load(e + k), e01 = S::load(e + n + k);
        V x = S::load(sx + k), y = S::load(sy + k), s = S::load(kept + k);
        if constexpr (Make) {
            V free = e00 * x + e01 * y, next = S::load(e + 2 * n + k) * x + S::load(e + 3 * n + k) * y, push{};
            for (int p = 0; p < n_ports; ++p) push += S::load(rows + 2 * p * n + k) * force[p];
            if constexpr (!Plain) {
                for (int j = 0; j < v.n_inputs; ++j) {
                    const T value = T(v.inputs[j].values[v.made_in * v.inputs[j].stride]);
                    free += S::load(v.inputs[j].vector + k) * value, next += S::load(v.inputs[j].vector + n + k) * value;
                }
                for (int j = 0; j < v.n_loads; ++j) push += S::load(v.loads[j].row + k) * v.loads[j].force;
            }
            const V pull = a * half_made, stiff = T(1) + gain * pull;
            for (int i = 0; i < kNewtons; ++i) s *= T(2) - stiff * s;
            push -= pull * ((x + free + gain * push) * s);
            x = free + gain * push, y = next + S::load(gains + n + k) * push;
            S::store(sx + k, x), S::store(sy + k, y);
        }
        if constexpr (Begin) {
            V free = e00 * x + e01 * y;
            if constexpr (!Plain)
                for (int j = 0; j < v.n_inputs; ++j)
                    free += S::load(v.inputs[j].vector + k) * T(v.inputs[j].values[v.begun * v.inputs[j].stride]);
            const V stiff = T(1) + gain * (a * half_tried);
            for (int i = 0; i < kNewtons; ++i) s *= T(2) - stiff * s;
            const V U = (x + free) * s, after = U - x, m = a * gain * s, am = a * m;
            all[0] += a * x * x;
            all[1] += a * after * after;
            all[2] += am * U * after;
            all[3] += am * m * (U * U + x * x);
            for (int p = 0; p < n_ports; ++p) {
                const V r = S::load(rows + 2 * p * n + k), rm = r * m, rmm = rm * m;
                each[p][0] += r * x, each[p][1] += r * U;
                each[p][2] += rm * x, each[p][3] += rm * U;
                each[p][4] += rmm * x, each[p][5] += rmm * U;
            }
        }
        S::store(kept + k, s);
    }
    if constexpr (Begin) {
        for (int i = 0; i < kSharedSums; ++i) S::store(shared + i * S::width, all[i]);
        for (int p = 0; p < n_ports; ++p)
            for (int i = 0; i < kPortSums; ++i) S::store(own + (p * kPortSums + i) * S::width, each[p][i]);
    }
}

template <class T, bool Make, bool Begin, bool Plain>
void visit(const Component<T>& c, T* sx, T* sy, T* kept, const Visit<T>& v, T* shared, T* own) {
    switch (c.n_ports) {
        case 0: return visit<T, 0, Make, Begin, Plain>(c, sx, sy, kept, v, shared, own);
        case 1: return visit<T, 1, Make, Begin, Plain>(c, sx, sy, kept, v, shared, own);
        case 2: return visit<T, 2, Make, Begin, Plain>(c, sx, sy, kept, v, shared, own);
        default: return visit<T, -1, Make, Begin, Plain>(c, sx, sy, kept, v, shared, own);
    }
}

// How the compliances between a component's ports change with its tension, about `at`: coefficients of Taylor's
// polynomial, the first one less what it is at rest.
template <class T>
void compliances(const Component<T>& c, double at, int p, int q, double* out) {
    const std::size_t n = c.n;
    const T *to = &c.rows[2 * std::size_t(p) * n], *from = &c.rows[2 * std::size_t(q) * n];
    std::fill_n(out, kTaylor, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double gain = c.stretched.gain[k], half = 0.5 * gain * double(c.stretched.weight[k]);
        const double s = 1.0 / (1.0 + half * at);
        double term = double(to[k]) * double(from[k]) * gain * s;
        out[0] -= term * half * at;
        for (int j = 1; j < kTaylor; ++j) out[j] += term *= -half * s;
    }
}

}  // namespace
}  // namespace tonewood
