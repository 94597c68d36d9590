// Dense solves: Cholesky factors, and inverses by Gauss and Jordan with two choices of the pivot.
#pragma once

#include <algorithm>
#include <cmath>

#include "products.hpp"

namespace tonewood {
namespace {

inline std::size_t wide(int n) { return padded(std::size_t(n)); }

// Factorizes a (n, wide(n)) as L L^T: the lower triangle in place, a column of it in each row of `upper`, one over the
// diagonal in `over`; the rest is zero. No pivot is below 1.
inline void factorize(double* a, int n, double* upper, double* over) {
    const std::size_t w = wide(n);
    for (int j = 0; j < n; ++j) {
        for (std::size_t i = j + 1; i < w; ++i) a[j * w + i] = 0.0;
        for (int i = 0; i < n; ++i) upper[j * w + i] = 0.0;
        for (int i = j; i < n; ++i) {
            double sum = a[i * w + j];
            for (int k = 0; k < j; ++k) sum -= a[i * w + k] * a[j * w + k];
            upper[j * w + i] = a[i * w + j] = i == j ? std::sqrt(std::max(sum, 1.0)) : sum * over[j];
            if (i == j) over[j] = 1 / a[i * w + j];
        }
        upper[j * w + j] = a[j * w + j] = 0.0;  // `over` replaces it
    }
}

// Solves a x = b in place, a given by its factors.
inline void solve_definite(const double* lower, const double* upper, const double* over, int n, double* b) {
    using S = Simd;
    const std::size_t w = wide(n);
    const auto subtract = [&](const double* row, double x, std::size_t from, std::size_t to) {
        for (std::size_t i = from / S::width * S::width; i < to; i += S::width)
            S::store(b + i, S::load(b + i) - S::load(row + i) * x);
    };
    for (int k = 0; k < n; ++k) subtract(upper + k * w, b[k] *= over[k], k, w);
    for (int k = n - 1; k >= 0; --k) subtract(lower + k * w, b[k] *= over[k], 0, k);
}

// Eliminates row and column p of a (n, w) in the exchange form: afterwards a maps with x_p and b_p exchanged.
inline void exchange(double* a, int n, std::size_t w, int p) {
    const double pivot = a[p * w + p];
    a[p * w + p] = 1.0;
    for (int j = 0; j < n; ++j) a[p * w + j] /= pivot;
    for (int i = 0; i < n; ++i) {
        if (i == p) continue;
        const double ratio = a[i * w + p];
        a[i * w + p] = 0.0;
        for (int j = 0; j < n; ++j) a[i * w + j] -= ratio * a[p * w + j];
    }
}

// Inverts a (n, w) in place, with the largest pivot of each column.
inline void invert(double* a, int n, std::size_t w, int* pivots) {
    for (int p = 0; p < n; ++p) {
        int best = p;
        for (int i = p + 1; i < n; ++i)
            if (std::abs(a[i * w + p]) > std::abs(a[best * w + p])) best = i;
        pivots[p] = best;
        for (int j = 0; j < n; ++j) std::swap(a[p * w + j], a[best * w + j]);
        exchange(a, n, w, p);
    }
    for (int p = n - 1; p >= 0; --p)
        for (int i = 0; i < n; ++i) std::swap(a[i * w + p], a[i * w + pivots[p]]);
}

// Inverse a (m, m) of a symmetric matrix scaled to ones on its diagonal, with pivots on the diagonal. A redundant
// connection, whose pivot vanishes, has zeros. `d` takes the roots of the diagonal, `done` which pivots were used.
inline void invert_symmetric(const double* matrix, int m, double* a, double* d, char* done) {
    for (int j = 0; j < m; ++j) {
        d[j] = matrix[j * m + j] > 0.0 ? std::sqrt(matrix[j * m + j]) : 0.0;
        done[j] = 0;
    }
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) a[i * m + j] = d[i] * d[j] > 0.0 ? matrix[i * m + j] / (d[i] * d[j]) : 0.0;
    for (int count = 0; count < m; ++count) {
        int p = -1;
        for (int j = 0; j < m; ++j)
            if (!done[j] && (p < 0 || std::abs(a[j * m + j]) > std::abs(a[p * m + p]))) p = j;
        if (!(std::abs(a[p * m + p]) > 1e-12)) break;
        done[p] = 1;
        exchange(a, m, m, p);
    }
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) a[i * m + j] = done[i] && done[j] ? a[i * m + j] / (d[i] * d[j]) : 0.0;
}

}  // namespace
}  // namespace tonewood
