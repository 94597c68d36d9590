// Products of one matrix with the vectors of one or two planes of motion at once: each number of the matrix is loaded once.
#pragma once

#include <algorithm>
#include <utility>

#include "../modal/pass.hpp"

namespace tonewood {
namespace {

// B vectors of columns of to[p] = matrix^T x[p]. Where these are few, two partial sums each break the chain of additions.
template <int Planes, int B>
inline void plane_columns(const double* matrix, int width, int n, const double* const* x, double* const* to, int at) {
    using S = Simd;
    constexpr int split = Planes * B < 8 ? 2 : 1;
    S::V sum[split][Planes][B] = {};
    const double* row = matrix + at;
    const auto add = [&](int part, int k) {
        for (int j = 0; j < B; ++j) {
            const S::V here = S::load(row + j * S::width);
            for (int p = 0; p < Planes; ++p) sum[part][p][j] += here * x[p][k];
        }
        row += width;
    };
    int k = 0;
    for (; k + split <= n; k += split)
        for (int part = 0; part < split; ++part) add(part, k + part);
    for (; k < n; ++k) add(0, k);
    for (int p = 0; p < Planes; ++p)
        for (int j = 0; j < B; ++j)
            S::store(to[p] + at + j * S::width, split == 2 ? sum[0][p][j] + sum[split - 1][p][j] : sum[0][p][j]);
}

// to[p] = matrix^T x[p]: matrix (n, width) by blocks of columns, width a multiple of kLane.
template <int Planes>
inline void multiply_planes(const double* matrix, int width, int n, const double* const* x, double* const* to) {
    if (n == 0) {  // a plane without modes: the matrix may be a null pointer
        for (int p = 0; p < Planes; ++p) std::fill_n(to[p], width, 0.0);
        return;
    }
    constexpr int lanes = Simd::width, most = kPack > 2 ? int(kColumns) / lanes : kPack;  // as many as the registers hold
    for (int first = 0, end; first < width; first = end) {
        const int columns = int(block_columns(std::size_t(width - first)));
        end = first + columns;
        double* here[Planes];
        for (int p = 0; p < Planes; ++p) here[p] = to[p] + first;
        int at = 0;
        const auto take = [&]<int B>(std::integral_constant<int, B>) {
            plane_columns<Planes, B>(matrix, columns, n, x, here, at);
            at += B * lanes;
        };
        while (columns - at > most * lanes) take(std::integral_constant<int, most>{});
        const auto rest = [&]<int... B>(std::integer_sequence<int, B...>) {
            const int left = (columns - at) / lanes;
            (void)((left == B + 1 && (take(std::integral_constant<int, B + 1>{}), true)) || ...);
        };
        rest(std::make_integer_sequence<int, most>{});
        matrix += std::size_t(columns) * std::size_t(n);
    }
}

}  // namespace
}  // namespace tonewood
