// The step itself, block by block: free motion of all components, the forces sample by sample, then the correction.
//
// Within a block a row's value is   y(b) = free(b) + sum_{k < b} H(b - 1 - k) F(k),   H(k) = C E^k W0:
// so the modes are visited twice per block however many samples it has; the forces couple the components each sample.
#pragma once

#include <algorithm>
#include <cmath>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "sweep.hpp"

namespace tonewood {
namespace {

// Denormals cost time in decayed tails: flush them to zero while stepping, and leave the process as it was.
struct FlushDenormals {
#if defined(__x86_64__)
    unsigned saved = _mm_getcsr();
    FlushDenormals() { _mm_setcsr(saved | 0x8040); }
    ~FlushDenormals() { _mm_setcsr(saved); }
#endif
};

// Where everything of a run lies: all rows of all components in one buffer, all shares of ports in gaps in one list.
struct Plan {
    struct Term {
        int row;         // of the port in `value`
        int force;       // of the port in `force`
        int connection;
        double factor;
        bool two_way;
    };
    std::vector<int> row, port;  // first row and port of each component
    std::vector<Term> terms;
    int n_rows = 0, n_ports = 0;

    template <class T>
    explicit Plan(const std::vector<Component<T>>& components) {
        for (const Component<T>& c : components) {
            row.push_back(n_rows), port.push_back(n_ports);
            for (int p = 0; p < c.n_ports; ++p)
                for (const Share& s : c.shares[p])
                    terms.push_back({n_rows + p, n_ports + p, s.connection, s.factor, !c.driven});
            n_rows += c.n_rows, n_ports += c.n_ports;
        }
    }
};

// The known forces that act in the block of nb samples from `start`, for each component.
template <class T>
void gather(const Job<T>& job, const std::vector<Component<T>>& components, std::int64_t start, int nb,
            std::vector<std::vector<Input<T>>>& known, std::vector<Array<double>>& values) {
    for (int q = 0; q < job.n_injections; ++q) {
        const Injection<T>& in = job.injections[q];
        if (start + nb <= in.first || start >= in.first + in.length) continue;
        values[q].assign(std::size_t(in.n_vectors) * kBlock, 0.0);
        const std::size_t size = 2 * std::size_t(components[in.slot].n);
        for (int v = 0; v < in.n_vectors; ++v) {
            for (int b = 0; b < nb; ++b) {
                const std::int64_t at = start + b - in.first;
                if (at >= 0 && at < in.length) values[q][v * kBlock + b] = in.values[v * in.length + at];
            }
            known[in.slot].push_back({in.vectors + v * size, &values[q][v * kBlock]});
        }
    }
}

template <class T>
Fault run(const std::vector<Component<T>>& components, const Solve& solve, const Job<T>& job) {
    const FlushDenormals guard;
    const Plan plan(components);
    const int n_components = int(components.size()), m = solve.m, stride = solve.stride;

    Array<double> value(std::size_t(plan.n_rows) * kStride);    // rows: free motion, then the motion
    Array<double> force(std::size_t(plan.n_ports) * kBlock);    // of ports
    Array<double> gap(stride), gap_free(stride), f(stride);
    std::vector<std::vector<Input<T>>> known(n_components);
    std::vector<Array<double>> known_values(job.n_injections);

    for (std::int64_t start = 0; start < job.n; start += kBlock) {
        const int nb = int(job.n - start < kBlock ? job.n - start : kBlock);
        for (auto& list : known) list.clear();
        gather(job, components, start, nb, known, known_values);

        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            if (c.driven) continue;
            T *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            double* rows = &value[std::size_t(plan.row[i]) * kStride];
            // many rows are cheaper read from one turning motion
            if (known[i].empty() && nb == kBlock && c.n_rows <= 2)
                recur_read(c, x, y, rows);
            else
                turn<T, true, false>(c, x, y, known[i].data(), int(known[i].size()), nb, rows);
            // looked at here too, before connections spread a fault to other components
            double check = 0.0;
            for (int r = 0; r < c.n_rows; ++r) check += rows[r * kStride + nb];
            if (!std::isfinite(check)) return {i, start};
        }

        // forces, sample by sample
        std::fill(force.begin(), force.end(), 0.0);
        for (int b = 0; b < nb; ++b) {
            std::fill(gap.begin(), gap.end(), 0.0);
            std::fill(gap_free.begin(), gap_free.end(), 0.0);
            for (const Plan::Term& t : plan.terms) {
                if (!t.two_way) continue;
                const double* y = &value[std::size_t(t.row) * kStride + b];
                gap[t.connection] += t.factor * y[0];
                gap_free[t.connection] += t.factor * y[1];
            }
            for (int k = 0; k < stride; ++k) f[k] = solve.constant[k];
            for (int j = 0; j < m; ++j) {
                const double v = gap_free[j] + solve.gamma[j] * gap[j];
                const double* g = &solve.g_t[std::size_t(j) * stride];
                for (int k = 0; k < stride; k += 8)
                    for (int lane = 0; lane < 8; ++lane) f[k + lane] -= g[k + lane] * v;
            }
            for (int j = 0; j < m; ++j) job.forces[(start + b) * m + j] = f[j];
            for (const Plan::Term& t : plan.terms) force[t.force * kBlock + b] += t.factor * f[t.connection];
            // what these forces do to every row in the rest of the block (and, unread, beyond it)
            for (int i = 0; i < n_components; ++i) {
                const Component<T>& c = components[i];
                if (c.driven) continue;
                const double* h = c.history.data();
                for (int p = 0; p < c.n_ports; ++p) {
                    const double now = force[(plan.port[i] + p) * kBlock + b];
                    double* later = &value[std::size_t(plan.row[i]) * kStride + b + 1];
                    for (int r = 0; r < c.n_rows; ++r, h += kBlock, later += kStride)
                        for (int k = 0; k < kBlock; ++k) later[k] += h[k] * now;
                }
            }
        }

        // the correction: inputs known by now move the state
        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            T *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            auto& inputs = known[i];
            const double* forces = &force[std::size_t(plan.port[i]) * kBlock];
            if (!c.driven && inputs.empty() && nb == kBlock && c.n_ports <= 2) {
                recur_store(c, x, y, forces);
                continue;
            }
            for (int p = 0; p < c.n_ports; ++p)
                inputs.push_back({&c.w[std::size_t(2 * p) * c.n], forces + p * kBlock});
            if (c.driven)
                turn<T, true, true>(c, x, y, inputs.data(), int(inputs.size()), nb,
                                    &value[std::size_t(plan.row[i]) * kStride]);
            else
                turn<T, false, true>(c, x, y, inputs.data(), int(inputs.size()), nb, nullptr);
        }

        for (int b = 0; b < nb; ++b)
            for (int o = 0; o < job.n_channels; ++o) {
                const double *w = &solve.weights[std::size_t(o) * m], *fb = job.forces + (start + b) * m;
                double total = 0.0;
                for (int j = 0; j < m; ++j) total += w[j] * fb[j];
                job.out[(start + b) * job.n_channels + o] = total;
            }
        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            double check = 0.0;
            for (int r = 0; r < c.n_rows; ++r) {
                const double* y = &value[std::size_t(plan.row[i] + r) * kStride];
                check += y[nb];
                if (r < c.n_ports) continue;
                double* out = job.out + start * job.n_channels + c.channels[r - c.n_ports];
                if (c.difference[r - c.n_ports])
                    for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[b + 1] - y[b];
                else
                    for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[b];
            }
            if (!std::isfinite(check)) return {i, start};
        }
    }
    // a component that nothing reads is looked at once per run
    for (int i = 0; i < n_components; ++i) {
        const Component<T>& c = components[i];
        double check = 0.0;
        for (int k = 0; k < c.n; ++k) check += double(job.modes[0][c.offset + k]) + double(job.modes[1][c.offset + k]);
        if (!std::isfinite(check)) return {i, job.n};
    }
    return {};
}

}  // namespace
}  // namespace tonewood
