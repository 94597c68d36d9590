// The step itself, block by block: free motion of all components, the forces sample by sample, then the correction.
//
// Within a block a row's value is   y(b) = free(b) + sum_{k < b} H(b - 1 - k) F(k),   H(k) = C E^k W0,
// so the modes are visited twice per block however many samples it has; the forces couple the components each sample.
#pragma once

#include <cmath>
#include <cstring>

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

template <class T>
Fault run(const std::vector<Component<T>>& components, const Solve& solve, const Job<T>& job) {
    const FlushDenormals guard;
    constexpr int stride = kBlock + 1;
    const int n_components = int(components.size()), m = solve.m;

    std::vector<Array<double>> value(n_components);  // (row_stride?) rows x stride: free motion, then the motion
    std::vector<Array<double>> port_force(n_components);  // (n_ports, kBlock)
    for (int i = 0; i < n_components; ++i) {
        value[i].assign(std::size_t(components[i].n_rows) * stride, 0.0);
        port_force[i].assign(std::size_t(components[i].n_ports) * kBlock, 0.0);
    }
    std::vector<std::vector<Input<T>>> known(n_components);
    std::vector<Array<double>> known_values(job.n_injections);
    Array<double> gap(m), gap_free(m), partial;

    for (std::int64_t start = 0; start < job.n; start += kBlock) {
        const int nb = int(job.n - start < kBlock ? job.n - start : kBlock);

        for (auto& list : known) list.clear();
        for (int q = 0; q < job.n_injections; ++q) {
            const Injection<T>& in = job.injections[q];
            if (start + nb <= in.first || start >= in.first + in.length) continue;
            auto& values = known_values[q];
            values.assign(std::size_t(in.n_vectors) * kBlock, 0.0);
            const std::size_t size = 2 * std::size_t(components[in.slot].n);
            for (int v = 0; v < in.n_vectors; ++v) {
                for (int b = 0; b < nb; ++b) {
                    const std::int64_t at = start + b - in.first;
                    if (at >= 0 && at < in.length) values[v * kBlock + b] = in.values[v * in.length + at];
                }
                known[in.slot].push_back({in.vectors + v * size, &values[v * kBlock]});
            }
        }

        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            if (c.driven) continue;
            T *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            sweep<T, true, false>(c, x, y, known[i].data(), int(known[i].size()), nb, value[i].data());
        }

        // forces, sample by sample
        for (int b = 0; b < nb; ++b) {
            double* f = job.forces + (start + b) * m;
            for (int j = 0; j < m; ++j) gap[j] = gap_free[j] = 0.0;
            for (int i = 0; i < n_components; ++i) {
                const Component<T>& c = components[i];
                if (c.driven || c.n_rows == 0) continue;
                double* y = value[i].data();
                if (int(partial.size()) < c.row_stride) partial.resize(c.row_stride);
                for (int r = 0; r < c.row_stride; ++r) partial[r] = 0.0;
                for (int k = 0; k < b; ++k)
                    for (int q = 0; q < c.n_ports; ++q) {
                        const double fq = port_force[i][q * kBlock + k];
                        const double* h = &c.history[(std::size_t(b - k) * c.n_ports + q) * c.row_stride];
                        for (int r = 0; r < c.row_stride; ++r) partial[r] += h[r] * fq;
                    }
                for (int r = 0; r < c.n_rows; ++r) y[r * stride + b + 1] += partial[r];
                for (int p = 0; p < c.n_ports; ++p)
                    for (const Share& s : c.shares[p]) {
                        gap[s.connection] += s.factor * y[p * stride + b];
                        gap_free[s.connection] += s.factor * y[p * stride + b + 1];
                    }
            }
            for (int j = 0; j < m; ++j) f[j] = solve.constant[j];
            for (int j = 0; j < m; ++j) {
                const double v = gap_free[j] + solve.gamma[j] * gap[j];
                const double* g = &solve.g_t[std::size_t(j) * m];
                for (int k = 0; k < m; ++k) f[k] -= g[k] * v;
            }
            for (int i = 0; i < n_components; ++i) {
                const Component<T>& c = components[i];
                double* y = value[i].data();
                for (int p = 0; p < c.n_ports; ++p) {
                    double total = 0.0;
                    for (const Share& s : c.shares[p]) total += s.factor * f[s.connection];
                    port_force[i][p * kBlock + b] = total;
                    if (c.driven) continue;
                    const double* h = &c.history[std::size_t(p) * c.row_stride];
                    for (int r = 0; r < c.n_rows; ++r) y[r * stride + b + 1] += h[r] * total;
                }
            }
        }

        // the correction: inputs known by now move the state
        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            T *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            auto& inputs = known[i];
            for (int p = 0; p < c.n_ports; ++p)
                inputs.push_back({&c.w[std::size_t(2 * p) * c.n], &port_force[i][p * kBlock]});
            if (c.driven)
                sweep<T, true, true>(c, x, y, inputs.data(), int(inputs.size()), nb, value[i].data());
            else
                sweep<T, false, true>(c, x, y, inputs.data(), int(inputs.size()), nb, nullptr);
        }

        for (int b = 0; b < nb; ++b) {
            double* out = job.out + (start + b) * job.n_channels;
            const double* f = job.forces + (start + b) * m;
            for (int o = 0; o < job.n_channels; ++o) {
                const double* w = &solve.weights[std::size_t(o) * m];
                double total = 0.0;
                for (int j = 0; j < m; ++j) total += w[j] * f[j];
                out[o] = total;
            }
        }
        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            double check = 0.0;
            for (int r = 0; r < c.n_rows; ++r) {
                const double* y = &value[i][std::size_t(r) * stride];
                check += y[nb];
                if (r < c.n_ports) continue;
                const int channel = c.channels[r - c.n_ports];
                const bool difference = c.difference[r - c.n_ports];
                for (int b = 0; b < nb; ++b)
                    job.out[(start + b) * job.n_channels + channel] += difference ? y[b + 1] - y[b] : y[b];
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
