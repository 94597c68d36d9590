// Visits to the modes of one component: kBlock samples at a time, so that each mode is loaded once per block and turns
// in registers. Vector width is that of the translation unit's instruction set; the order of every sum is fixed.
#pragma once

#include "model.hpp"

namespace tonewood {
namespace {

template <class T>
struct Simd {
#if defined(__AVX512F__)
    static constexpr int width = 64 / sizeof(T);
#elif defined(__AVX2__)
    static constexpr int width = 32 / sizeof(T);
#else
    static constexpr int width = 16 / sizeof(T);
#endif
    typedef T V __attribute__((vector_size(width * sizeof(T))));
    // arrays that come from Python need not be aligned to the vector
    typedef T Loose __attribute__((vector_size(width * sizeof(T)), aligned(alignof(T)), may_alias));
};

template <class T>
double sum(const typename Simd<T>::V& v) {
    double s = 0;
    for (int i = 0; i < Simd<T>::width; ++i) s += v[i];
    return s;
}

// Turn the modes through nb samples, adding `inputs` on the way.
// Read: row values at samples 0 .. nb go to free[row * (kBlock + 1) + b].   Store: the state moves to sample nb.
template <class T, bool Read, bool Store>
void sweep(const Component<T>& c, T* sx, T* sy, const Input<T>* inputs, int n_inputs, int nb, double* free) {
    using V = typename Simd<T>::V;
    constexpr int width = Simd<T>::width;
    constexpr int unroll = 2;
    constexpr int chunk = width * unroll;
    static_assert(kPadding % chunk == 0 || chunk % kPadding == 0);
    const int n = c.n, n_rows = Read ? c.n_rows : 0;

    // accumulators of the rows, kept as vectors until the end
    thread_local Array<T> acc_store;
    V* acc = nullptr;
    if constexpr (Read) {
        const std::size_t need = std::size_t(n_rows) * (kBlock + 1) * width;
        if (acc_store.size() < need) acc_store.resize(need);
        acc = reinterpret_cast<V*>(acc_store.data());
        for (int i = 0; i < n_rows * (kBlock + 1); ++i) acc[i] = V{};
    }

    const auto load = [](const T* p) { return V(*reinterpret_cast<const typename Simd<T>::Loose*>(p)); };
    V tx[kBlock + 1][unroll], ty[kBlock + 1][unroll];
    for (int k = 0; k < n; k += chunk) {
        V x[unroll], y[unroll], a[unroll], b[unroll], c0[unroll], d[unroll];
        for (int u = 0; u < unroll; ++u) {
            const int i = k + u * width;
            x[u] = load(sx + i);
            y[u] = load(sy + i);
            a[u] = load(&c.e[i]);
            b[u] = load(&c.e[n + i]);
            c0[u] = load(&c.e[2 * n + i]);
            d[u] = load(&c.e[3 * n + i]);
        }
        for (int s = 0; s < nb; ++s) {
            for (int u = 0; u < unroll; ++u) {
                if constexpr (Read) tx[s][u] = x[u], ty[s][u] = y[u];
                const V nx = a[u] * x[u] + b[u] * y[u];
                y[u] = c0[u] * x[u] + d[u] * y[u];
                x[u] = nx;
            }
            for (int j = 0; j < n_inputs; ++j) {
                const T value = T(inputs[j].values[s]);
                for (int u = 0; u < unroll; ++u) {
                    const int i = k + u * width;
                    x[u] += load(inputs[j].vector + i) * value;
                    y[u] += load(inputs[j].vector + n + i) * value;
                }
            }
        }
        if constexpr (Read) {
            for (int u = 0; u < unroll; ++u) tx[nb][u] = x[u], ty[nb][u] = y[u];
            for (int r = 0; r < n_rows; ++r) {
                V rx[unroll], ry[unroll];
                for (int u = 0; u < unroll; ++u) {
                    rx[u] = load(&c.rows[std::size_t(2 * r) * n + k + u * width]);
                    ry[u] = load(&c.rows[std::size_t(2 * r + 1) * n + k + u * width]);
                }
                V* to = acc + std::size_t(r) * (kBlock + 1);
                for (int s = 0; s <= nb; ++s) {
                    V t = to[s];
                    for (int u = 0; u < unroll; ++u) t += rx[u] * tx[s][u] + ry[u] * ty[s][u];
                    to[s] = t;
                }
            }
        }
        if constexpr (Store) {
            for (int u = 0; u < unroll; ++u) {
                *reinterpret_cast<typename Simd<T>::Loose*>(sx + k + u * width) = x[u];
                *reinterpret_cast<typename Simd<T>::Loose*>(sy + k + u * width) = y[u];
            }
        }
    }
    if constexpr (Read)
        for (int r = 0; r < n_rows; ++r)
            for (int s = 0; s <= nb; ++s)
                free[r * (kBlock + 1) + s] = sum<T>(acc[std::size_t(r) * (kBlock + 1) + s]);
}

}  // namespace
}  // namespace tonewood
