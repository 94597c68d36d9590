// Displacements of the residual compliances in series with nonlinear connections.
#pragma once

#include <algorithm>
#include <cmath>

#include "../data/state.hpp"

namespace tonewood {
namespace {

constexpr double kSeriesAtRest = 1e-30;  // m: a residual compliance below this is at rest

class Series {
public:
    Series(const Nonlinear& nl, ContactState& ws) : nl_(nl), ws_(ws) {}

    void begin() {
        std::fill(ws_.series_moves.begin(), ws_.series_moves.end(), 0);
        ws_.any_series = false;
        for (int j = 0; j < nl_.k; ++j)
            if (ws_.series[j] != 0.0) start(j);
    }
    // Connection j moves the residual compliances of its group.
    void start(int j) {
        if (nl_.series[j] >= 0) ws_.series_moves[nl_.series[j]] = ws_.any_series = true;
    }
    bool in_motion(int j) const { return nl_.series[j] >= 0 && ws_.series_moves[nl_.series[j]]; }

    // Displacements after the step under the forces tried; returns the largest one before or after it.
    double find() {
        if (!ws_.any_series) return 0.0;
        const double old = (1 - nl_.theta) / nl_.theta, per = 1 / nl_.theta;
        const int k = nl_.k;
        const double* const __restrict before = ws_.series.data();
        double* const __restrict after = ws_.series_after.data();
        for (int j = 0; j < k; ++j) after[j] = -old * before[j];
        for (const int q : ws_.active) {  // a force moves its own group alone
            if (!in_motion(q)) continue;
            const double force = per * ws_.law_force[q];
            const double* const __restrict row = nl_.residual.data() + std::size_t(q) * k;
            for (int j = 0; j < k; ++j) after[j] += row[j] * force;
        }
        double farthest = 0.0;
        for (int j = 0; j < k; ++j) farthest = std::max({farthest, std::abs(before[j]), std::abs(after[j])});
        return farthest;
    }

    // The forces of the sample are final.
    void commit() {
        if (!ws_.any_series) return;
        ws_.any_series = false;
        for (int s = 0; s < nl_.n_series; ++s) {
            if (!ws_.series_moves[s]) continue;
            double most = 0.0;
            for (const int j : nl_.in_series[s]) most = std::max(most, std::abs(ws_.series_after[j]));
            const bool at_rest = most < kSeriesAtRest;
            for (const int j : nl_.in_series[s]) ws_.series[j] = at_rest ? 0.0 : ws_.series_after[j];
            ws_.series_moves[s] = !at_rest;
            ws_.any_series = ws_.any_series || !at_rest;
        }
    }

private:
    const Nonlinear& nl_;
    ContactState& ws_;
};

}  // namespace
}  // namespace tonewood
