// Displacements of the residual compliances in series with nonlinear connections.
#pragma once

#include <algorithm>
#include <cmath>

#include "../modal/simd.hpp"

namespace tonewood {
namespace {

constexpr double kSeriesAtRest = 1e-30;  // m: a residual compliance below this is at rest

class Series {
    using S = Simd;

public:
    Series(const Nonlinear& nl, ContactState& ws) : nl_(nl), ws_(ws) {}

    // Reads the displacements by connection.
    void begin(const double* by_connection) {
        for (int j = 0; j < nl_.k; ++j)
            if (nl_.series[j] >= 0) ws_.series[nl_.place[j]] = by_connection[j];
        begin_block(0.0);
    }
    void finish(double* by_connection) const {
        for (int j = 0; j < nl_.k; ++j)
            if (nl_.series[j] >= 0) by_connection[j] = ws_.series[nl_.place[j]];
    }

    // Groups whose displacements are at most `rest` do not move.
    void begin_block(double rest = kSeriesAtRest) {
        ws_.any_series = false;
        for (std::size_t g = 0; g < nl_.shared.size(); ++g) {
            const auto first = ws_.series.begin() + nl_.shared[g].first, end = first + nl_.shared[g].n;
            const bool moves = std::any_of(first, end, [&](double x) { return !(std::abs(x) <= rest); });
            if (!moves) std::fill(first, end, 0.0);
            ws_.series_moves[g] = moves, ws_.any_series = ws_.any_series || moves;
        }
    }

    // Connection j moves the residual compliances of its group.
    void start(int j) {
        if (nl_.series[j] >= 0) ws_.series_moves[nl_.series[j]] = ws_.any_series = true;
    }

    // Displacements after the step under the forces tried; returns the largest one before or after it.
    double find() {
        if (!ws_.any_series) return 0.0;
        const double old = (1 - nl_.theta) / nl_.theta, per = 1 / nl_.theta;
        const double* const __restrict before = ws_.series.data();
        double* const __restrict after = ws_.series_after.data();
        for (int i = 0; i < nl_.n_places; i += S::width) S::store(after + i, S::load(before + i) * -old);
        for (const int q : ws_.active) {  // a force moves its own group alone: the rest of its rows is zero
            if (nl_.series[q] < 0 || !ws_.series_moves[nl_.series[q]]) continue;
            const Nonlinear::Shared& group = nl_.shared[nl_.series[q]];
            const double force = per * ws_.law_force[q];
            const double* const row = group.residual.data() + std::size_t(nl_.place[q] - group.first) * group.width;
            for (int i = 0; i < group.width; i += S::width)
                S::store(after + group.first + i, S::load(after + group.first + i) + S::load(row + i) * force);
        }
        S::V most{};
        for (int i = 0; i < nl_.n_places; i += S::width) {
            const S::V x = S::load(before + i), y = S::load(after + i);
            const S::V far = x < 0.0 ? -x : x, other = y < 0.0 ? -y : y, size = far > other ? far : other;
            most = size > most ? size : most;
        }
        return S::largest(most);
    }

    // The forces of the sample are final.
    void commit() {
        if (ws_.any_series) std::swap(ws_.series, ws_.series_after);
    }

private:
    const Nonlinear& nl_;
    ContactState& ws_;
};

}  // namespace
}  // namespace tonewood
