// The rows and port forces of one block in lines, one for each sample, and products with the small matrices of Layout.
#pragma once

#include "simd.hpp"

namespace tonewood {
namespace {

// sum += matrix^T x over the rows of a (n, width) matrix, width a multiple of kLane
inline void add_product(const double* __restrict matrix, int width, const double* __restrict x, int n,
                        double* __restrict sum) {
    using S = Simd<double>;
    static_assert(kLane % S::width == 0);
    for (int k = 0; k < width; k += S::width) {
        // four sums side by side: a chain of additions would wait for itself
        S::V a = S::load(sum + k), b{}, c{}, d{};
        const double* column = matrix + k;
        int i = 0;
        for (; i + 3 < n; i += 4, column += 4 * width) {
            a += S::load(column) * x[i];
            b += S::load(column + width) * x[i + 1];
            c += S::load(column + 2 * width) * x[i + 2];
            d += S::load(column + 3 * width) * x[i + 3];
        }
        for (; i < n; ++i, column += width) b += S::load(column) * x[i];
        S::store(sum + k, (a + b) + (c + d));
    }
}

// What the port forces of one sample do to every row in the rest of the block. `lines` begins at the next sample.
inline void spread(const Layout& layout, const double* __restrict force, int n_left, double* __restrict per_row,
                   double* __restrict lines) {
    using S = Simd<double>;
    const int width = layout.width, single_width = layout.single_width;
    for (std::size_t i = 0; i < layout.singles.size(); ++i)
        per_row[i] = layout.singles[i] < 0 ? 0.0 : force[layout.singles[i]];
    const double* __restrict h = layout.single_history.data();
    for (int i = 0; i < single_width; i += S::width) {
        const S::V f = S::load(per_row + i);
        for (int k = 0; k < n_left; ++k) {
            double* line = lines + std::size_t(k) * width + i;
            S::store(line, S::load(line) + S::load(h + std::size_t(k) * single_width + i) * f);
        }
    }
    for (const Layout::Several& c : layout.several) {
        const double* __restrict hc = c.history.data();
        const double* __restrict f = force + c.force;
        for (int i = 0; i < c.width; i += S::width)
            for (int k = 0; k < n_left; ++k) {
                const double* __restrict column = hc + std::size_t(k) * c.n_ports * c.width + i;
                double* line = lines + std::size_t(k) * width + c.row + i;
                S::V even = S::load(line), odd{};
                int p = 0;
                for (; p + 1 < c.n_ports; p += 2, column += 2 * c.width) {
                    even += S::load(column) * f[p];
                    odd += S::load(column + c.width) * f[p + 1];
                }
                if (p < c.n_ports) even += S::load(column) * f[p];
                S::store(line, even + odd);
            }
    }
}

// Rows of a driven component over a whole block under known port forces. A row's history has kBlock zeros before it,
// so that its response to the force of sample b is read from it at one place for all samples.
inline void respond(const double* history, int n_ports, int n_rows, const double* forces, int stride, double* lines) {
    using S = Simd<double>;
    constexpr int n_vectors = kBlock / S::width;
    for (int r = 0; r < n_rows; ++r) {
        S::V sum[n_vectors] = {};
        for (int p = 0; p < n_ports; ++p) {
            const double* h = history + std::size_t(p * n_rows + r) * 2 * kBlock + kBlock;
            for (int b = 0; b < kBlock; ++b)
                for (int v = 0; v < n_vectors; ++v) sum[v] += S::load(h - b + v * S::width) * forces[b * stride + p];
        }
        for (int v = 0; v < n_vectors; ++v)
            for (int lane = 0; lane < S::width; ++lane) lines[(v * S::width + lane + 1) * n_rows + r] += sum[v][lane];
    }
}

}  // namespace
}  // namespace tonewood
