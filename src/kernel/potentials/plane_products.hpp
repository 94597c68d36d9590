// Products of one matrix with the vectors of one or two planes of motion at once: each number of the matrix is loaded once.
#pragma once

#include "../modal/pass.hpp"

namespace tonewood {
namespace {

// Blocks of B vectors of columns of to[p] = matrix^T x[p], a (n, width) matrix.
template <int Planes, int B>
inline void add_plane_columns(const double* matrix, int width, int n, const double* const* x, double* const* to, int at) {
    using S = Simd;
    S::V sum[Planes][B] = {};
    const double* row = matrix + at;
    for (int k = 0; k < n; ++k, row += width)
        for (int j = 0; j < B; ++j) {
            const S::V here = S::load(row + j * S::width);
            for (int p = 0; p < Planes; ++p) sum[p][j] += here * x[p][k];
        }
    for (int p = 0; p < Planes; ++p)
        for (int j = 0; j < B; ++j) S::store(to[p] + at + j * S::width, sum[p][j]);
}

// to[p] = matrix^T x[p]: matrix (n, width), width a multiple of kLane.
template <int Planes>
inline void multiply_columns(const double* matrix, int width, int n, const double* const* x, double* const* to) {
    constexpr int lanes = Simd::width;
    int at = 0;
    for (; at + kPack * lanes <= width; at += kPack * lanes)
        add_plane_columns<Planes, kPack>(matrix, width, n, x, to, at);
    if (kPack > 2 && at + 2 * lanes <= width) add_plane_columns<Planes, 2>(matrix, width, n, x, to, at), at += 2 * lanes;
    for (; at < width; at += lanes) add_plane_columns<Planes, 1>(matrix, width, n, x, to, at);
}

// to[p] = matrix x[p]: matrix (n, width), n and width multiples of kLane.
template <int Planes>
inline void multiply_rows(const double* matrix, int width, int n, const double* const* x, double* const* to) {
    using S = Simd;
    constexpr int count = S::width;
    alignas(64) double lanes[count * count];
    for (int k = 0; k < n; k += count, matrix += count * width) {
        S::V sum[Planes][count] = {};
        for (int i = 0; i < width; i += S::width) {
            S::V here[Planes];
            for (int p = 0; p < Planes; ++p) here[p] = S::load(x[p] + i);
            for (int r = 0; r < count; ++r) {
                const S::V row = S::load(matrix + r * width + i);
                for (int p = 0; p < Planes; ++p) sum[p][r] += row * here[p];
            }
        }
        for (int p = 0; p < Planes; ++p) {
            for (int r = 0; r < count; ++r) S::store(lanes + r * count, sum[p][r]);
            S::store(to[p] + k, sums<count>(lanes));
        }
    }
}

}  // namespace
}  // namespace tonewood
