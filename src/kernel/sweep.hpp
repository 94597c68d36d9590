// Visits to the modes of one component, kBlock samples at a time, so that each mode is loaded once per block and turns
// in registers. The order of every sum is fixed.
//
// Two ways to go through a block, chosen per visit:
//
// * turning: x+ = E x, sample by sample. Takes known inputs on the way and reads any number of rows.
// * recurring: by Cayley-Hamilton each mode's share s of a row obeys s'' = tr s' - det s. In differences, which keep
//   full precision for slow modes (Reinsch),
//       d+ = det d - kappa s,   s+ = s + d+,      kappa = det(I - E) = 1 - tr + det,
//   four operations per row and sample. The forces of a block go in through the transposed recurrence (Goertzel):
//       d+ = det d - kappa u + F,   u+ = u + d+,   x(kBlock) = E^kBlock x(0) + d W + (u - d) (I + E - tr) W,
//   three operations per port and sample.
#pragma once

#include "simd.hpp"

namespace tonewood {
namespace {

constexpr int kStride = 3 * kBlock;  // of a row's values: samples 0 .. kBlock, and room to write past the block's end

// Accumulators of rows, one vector per row and sample.
template <class T>
T* accumulators(int n_rows) {
    thread_local Array<T> memory;
    const std::size_t need = std::size_t(n_rows) * (kBlock + 1) * Simd<T>::width;
    if (memory.size() < need) memory.resize(need);
    for (std::size_t i = 0; i < need; ++i) memory[i] = T(0);
    return memory.data();
}

template <class T>
void reduce(const T* acc, int n_rows, int nb, double* value) {
    for (int r = 0; r < n_rows; ++r)
        for (int s = 0; s <= nb; ++s)
            value[r * kStride + s] = Simd<T>::sum(acc + (std::size_t(r) * (kBlock + 1) + s) * Simd<T>::width);
}

// Turning. Read: row values go to value[row * kStride + s], s = 0 .. nb. Store: the state moves on to sample nb.
template <class T, bool Read, bool Store>
void turn(const Component<T>& c, T* sx, T* sy, const Input<T>* inputs, int n_inputs, int nb, double* value) {
    constexpr int N = 2;
    using P = Pack<T, N>;
    constexpr int width = Simd<T>::width;
    static_assert(kPadding % P::size == 0);
    const std::size_t n = c.n;
    const int n_rows = Read ? c.n_rows : 0;
    T* const acc = Read ? accumulators<T>(n_rows) : nullptr;
    alignas(64) T path_x[(kBlock + 1) * P::size], path_y[(kBlock + 1) * P::size];

    for (std::size_t k = 0; k < n; k += P::size) {
        P x = P::load(sx + k), y = P::load(sy + k);
        const P e00 = P::load(&c.e[k]), e01 = P::load(&c.e[n + k]);
        const P e10 = P::load(&c.e[2 * n + k]), e11 = P::load(&c.e[3 * n + k]);
        for (int s = 0; s < nb; ++s) {
            if constexpr (Read) x.store(path_x + s * P::size), y.store(path_y + s * P::size);
            const P turned = mul_add(e00, x, e01 * y);
            y = mul_add(e11, y, e10 * x);
            x = turned;
            for (int j = 0; j < n_inputs; ++j) {
                const T f = T(inputs[j].values[s]);
                x = mul_add(P::load(inputs[j].vector + k), f, x);
                y = mul_add(P::load(inputs[j].vector + n + k), f, y);
            }
        }
        if constexpr (Read) {
            x.store(path_x + nb * P::size), y.store(path_y + nb * P::size);
            for (int r = 0; r < n_rows; ++r) {
                const P rx = P::load(&c.rows[2 * r * n + k]), ry = P::load(&c.rows[(2 * r + 1) * n + k]);
                T* to = acc + std::size_t(r) * (kBlock + 1) * width;
                for (int s = 0; s <= nb; ++s, to += width) {
                    const P share = mul_add(rx, P::load(path_x + s * P::size), ry * P::load(path_y + s * P::size));
                    Simd<T>::store(to, Simd<T>::load(to) + share.folded());
                }
            }
        }
        if constexpr (Store) x.store(sx + k), y.store(sy + k);
    }
    if constexpr (Read) reduce(acc, n_rows, nb, value);
}

// Recurring, a whole block: values of all rows, without inputs. The state stays.
template <class T>
void recur_read(const Component<T>& c, const T* sx, const T* sy, double* value) {
    using P = Pack<T, sizeof(T) == sizeof(double) ? kPack : kPack / 2>;
    constexpr int width = Simd<T>::width;
    static_assert(kPadding % P::size == 0);
    const std::size_t n = c.n;
    T* const acc = accumulators<T>(c.n_rows);
    for (int r = 0; r < c.n_rows; ++r) {
        const T* row = &c.rows[2 * r * n];
        const T* slope = &c.slopes[2 * r * n];
        T* const to = acc + std::size_t(r) * (kBlock + 1) * width;
        for (std::size_t k = 0; k < n; k += P::size) {
            const P x = P::load(sx + k), y = P::load(sy + k);
            const P det = P::load(&c.det[k]), kappa = P::load(&c.kappa[k]);
            P s = mul_add(P::load(row + k), x, P::load(row + n + k) * y);
            P d = mul_add(P::load(slope + k), x, P::load(slope + n + k) * y);
            Simd<T>::store(to, Simd<T>::load(to) + s.folded());
            for (int b = 1; b < kBlock; ++b) {
                s = s + d;
                d = neg_mul_add(kappa, s, det * d);
                Simd<T>::store(to + b * width, Simd<T>::load(to + b * width) + s.folded());
            }
            s = s + d;
            Simd<T>::store(to + kBlock * width, Simd<T>::load(to + kBlock * width) + s.folded());
        }
    }
    reduce(acc, c.n_rows, kBlock, value);
}

// Recurring, a whole block: the state moves on under the port forces (n_ports, kBlock).
template <class T>
void recur_store(const Component<T>& c, T* sx, T* sy, const double* forces) {
    using P = Pack<T, sizeof(T) == sizeof(double) ? kPack : kPack / 2>;
    const std::size_t n = c.n;
    for (std::size_t k = 0; k < n; k += P::size) {
        const P x = P::load(sx + k), y = P::load(sy + k);
        P nx = mul_add(P::load(&c.e_block[k]), x, P::load(&c.e_block[n + k]) * y);
        P ny = mul_add(P::load(&c.e_block[3 * n + k]), y, P::load(&c.e_block[2 * n + k]) * x);
        const P det = P::load(&c.det[k]), kappa = P::load(&c.kappa[k]);
        for (int p = 0; p < c.n_ports; ++p) {
            const double* f = forces + p * kBlock;
            P d{}, u{};
            d = mul_plus(det, d, T(f[0]));
            u = d;
            for (int b = 1; b < kBlock; ++b) {
                d = neg_mul_add(kappa, u, mul_plus(det, d, T(f[b])));
                u = u + d;
            }
            u = u - d;
            const T *w = &c.w[2 * p * n + k], *v = &c.w_slope[2 * p * n + k];
            nx = mul_add(P::load(w), d, mul_add(P::load(v), u, nx));
            ny = mul_add(P::load(w + n), d, mul_add(P::load(v + n), u, ny));
        }
        nx.store(sx + k), ny.store(sy + k);
    }
}

}  // namespace
}  // namespace tonewood
