// Dense solves by Cholesky factors.
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
    using S = Simd;
    for (int j = 0; j < n; ++j) {
        double *const column = upper + j * w, *const row = a + j * w;
        over[j] = 1 / std::sqrt(std::max(row[j], 1.0));
        std::fill_n(column, w, 0.0), std::fill(row + j, row + w, 0.0);  // `over` replaces the diagonal
        for (int i = j + 1; i < n; ++i) column[i] = a[i * w + j] *= over[j];
        for (int i = j + 1; i < n; ++i) {
            double* const below = a + i * w;
            for (int k = j / S::width * S::width; k <= i; k += S::width)
                S::store(below + k, S::load(below + k) - S::load(column + k) * column[i]);
        }
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

// Solves a x = b in place, a (n, kLane) symmetric and positive definite, n below kLane: a is eliminated beside b in rows of kLane
// numbers, which takes no square roots and reads no vector that was written number by number. `unit` (2 kLane) has a
// one in the middle.
inline void solve_few(const double* a, const double* unit, int n, double* b) {
    using S = Simd;
    alignas(64) double rows[kLane * kLane];
    double over[kLane];
    for (int i = 0; i < n; ++i)
        for (int k = 0; k < kLane; k += S::width)
            S::store(rows + i * kLane + k, S::load(a + i * kLane + k) + S::load(unit + kLane - n + k) * b[i]);
    for (int j = 0; j < n; ++j) {
        const double* const row = rows + j * kLane;
        over[j] = 1 / row[j];
        for (int i = 0; i < n; ++i) {
            if (i == j) continue;
            double* const other = rows + i * kLane;
            const double factor = other[j] * over[j];
            for (int k = j / S::width * S::width; k < kLane; k += S::width)
                S::store(other + k, S::load(other + k) - S::load(row + k) * factor);
        }
    }
    for (int i = 0; i < n; ++i) b[i] = rows[i * kLane + n] * over[i];
}

constexpr int kMostDirections = 12;  // of conjugate gradients: more take about as long as the factors
constexpr double kResidual = 1e-32;  // squared, of that of x = 0

// Solves a x = b in place by conjugate gradients scaled by the diagonal; a (n, wide(n)) symmetric and positive definite,
// all of it given. Uses 4 wide(n) numbers of `work` and wide(n) of `over`. False, with b as it was, where that takes too
// many directions.
inline bool solve_near_diagonal(const double* a, int n, double* over, double* work, double* b) {
    using S = Simd;
    using V = S::V;
    const std::size_t w = wide(n);
    double *const x = work, *const r = x + w, *const p = r + w, *const moved = p + w;
    const auto sum_over = [&](const auto& term) {
        V sum{};
        for (std::size_t i = 0; i < w; i += S::width) sum += term(i);
        return S::sum(sum);
    };
    std::fill_n(over, w, 0.0), std::fill_n(x, w, 0.0), std::copy_n(b, w, r);
    for (int i = 0; i < n; ++i) over[i] = 1 / a[i * w + i];
    const double first = sum_over([&](std::size_t i) {
        const V residual = S::load(r + i), scaled = residual * S::load(over + i);
        S::store(p + i, scaled);
        return residual * scaled;
    });
    if (!std::isfinite(first)) return false;
    double size = first;
    for (int k = 0; size > kResidual * first; ++k) {
        if (k == kMostDirections) return false;
        std::fill_n(moved, w, 0.0);
        add_product(a, int(w), p, n, moved);
        const double far = size / sum_over([&](std::size_t i) { return S::load(p + i) * S::load(moved + i); });
        const double left = sum_over([&](std::size_t i) {
            S::store(x + i, S::load(x + i) + S::load(p + i) * far);
            const V residual = S::load(r + i) - S::load(moved + i) * far;
            S::store(r + i, residual);
            return residual * residual * S::load(over + i);
        });
        const double kept = left / size;
        for (std::size_t i = 0; i < w; i += S::width)
            S::store(p + i, S::load(r + i) * S::load(over + i) + S::load(p + i) * kept);
        size = left;
    }
    std::copy_n(x, w, b);
    return true;
}

// Solves a X = B in place for all columns of B (n, width) at once, width a multiple of kLane.
inline void solve_columns(const double* lower, const double* over, int n, double* b, std::size_t width) {
    using S = Simd;
    const std::size_t w = wide(n);
    const auto scale = [&](int k) {
        for (std::size_t i = 0; i < width; i += S::width)
            S::store(b + k * width + i, S::load(b + k * width + i) * over[k]);
    };
    const auto subtract = [&](int from, int to, double x) {
        for (std::size_t i = 0; i < width; i += S::width)
            S::store(b + to * width + i, S::load(b + to * width + i) - S::load(b + from * width + i) * x);
    };
    for (int k = 0; k < n; ++k) {
        scale(k);
        for (int i = k + 1; i < n; ++i) subtract(k, i, lower[i * w + k]);
    }
    for (int k = n - 1; k >= 0; --k) {
        scale(k);
        for (int i = 0; i < k; ++i) subtract(k, i, lower[k * w + i]);
    }
}

}  // namespace
}  // namespace tonewood
