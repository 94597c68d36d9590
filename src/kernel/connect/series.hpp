// Displacements of the residual compliances in series with nonlinear connections.
#pragma once

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
        ws_.any_series = false;
        for (int j = 0; j < nl_.k; ++j)
            if (nl_.series[j] >= 0) ws_.series[nl_.place[j]] = by_connection[j];
        for (std::size_t g = 0; g < nl_.shared.size(); ++g) {
            const Nonlinear::Shared& group = nl_.shared[g];
            ws_.series_most[g] = largest(ws_.series.data() + group.first, group.width);
            ws_.series_moves[g] = ws_.series_most[g] != 0.0;
            ws_.any_series = ws_.any_series || ws_.series_moves[g];
        }
    }
    void finish(double* by_connection) const {
        for (int j = 0; j < nl_.k; ++j)
            if (nl_.series[j] >= 0) by_connection[j] = ws_.series[nl_.place[j]];
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
        for (const int q : ws_.active) {  // a force moves its own group alone
            if (nl_.series[q] < 0 || !ws_.series_moves[nl_.series[q]]) continue;
            const Nonlinear::Shared& group = nl_.shared[nl_.series[q]];
            const double force = per * ws_.law_force[q];
            const double* const row = group.residual.data() + std::size_t(nl_.place[q] - group.first) * group.width;
            for (int i = 0; i < group.width; i += S::width)
                S::store(after + group.first + i, S::load(after + group.first + i) + S::load(row + i) * force);
        }
        double farthest = 0.0;
        for (std::size_t g = 0; g < nl_.shared.size(); ++g) {
            ws_.series_most_after[g] = largest(after + nl_.shared[g].first, nl_.shared[g].width);
            farthest = std::max({farthest, ws_.series_most[g], ws_.series_most_after[g]});
        }
        return farthest;
    }

    // The forces of the sample are final.
    void commit() {
        if (!ws_.any_series) return;
        ws_.any_series = false;
        for (std::size_t g = 0; g < nl_.shared.size(); ++g) {
            if (!ws_.series_moves[g]) continue;
            const Nonlinear::Shared& group = nl_.shared[g];
            const bool moves = !(ws_.series_most_after[g] < kSeriesAtRest);
            ws_.series_most[g] = moves ? ws_.series_most_after[g] : 0.0, ws_.series_moves[g] = moves;
            if (moves)
                std::copy_n(ws_.series_after.begin() + group.first, group.width, ws_.series.begin() + group.first);
            else std::fill_n(ws_.series.begin() + group.first, group.width, 0.0);
            ws_.any_series = ws_.any_series || moves;
        }
    }

private:
    static double largest(const double* x, int n) {
        S::V most{};
        for (int i = 0; i < n; i += S::width) {
            const S::V v = S::load(x + i), size = v < 0.0 ? -v : v;
            most = size > most ? size : most;
        }
        return S::largest(most);
    }

    const Nonlinear& nl_;
    ContactState& ws_;
};

}  // namespace
}  // namespace tonewood
