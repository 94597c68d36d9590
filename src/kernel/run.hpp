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

inline bool finite(const double* x, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; ++i) sum += x[i];
    return std::isfinite(sum);
}

// Adds a component's readouts to the output.
template <class T>
void emit(const Component<T>& c, const double* rows, int stride, std::int64_t start, int nb, const Job<T>& job) {
    const int first = c.driven ? 0 : c.n_ports;
    for (int r = first; r < c.n_rows; ++r) {
        double* out = job.out + start * job.n_channels + c.channels[r - first];
        const double* y = rows + r;
        if (c.difference[r - first])
            for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[(b + 1) * stride] - y[b * stride];
        else
            for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[b * stride];
    }
}

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

template <class T>
Fault run(const std::vector<Component<T>>& components, const Layout& layout, const Solve& solve, const Job<T>& job) {
    const FlushDenormals guard;
    const int n_components = int(components.size()), m = solve.m, width = layout.width;
    const int force_width = layout.force_width, n_ports = int(layout.port_rows.size());

    Array<double> lines(std::size_t(kBlock + 1) * width);       // rows at samples 0 .. kBlock: free, then moved
    Array<double> driven_lines;                                 // rows of one driven component
    Array<double> force(std::size_t(kBlock) * force_width);     // of ports, a line per sample
    Array<double> f(layout.f_width), per_row(layout.single_width);
    Array<double> y(2 * n_ports);  // port displacements: free at the step's end, then at its beginning
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
            // many rows are cheaper read from one turning motion
            if (known[i].empty() && nb == kBlock && c.n_rows <= 2)
                recur_read(c, x, y, &lines[layout.row[i]], width);
            else
                turn<T, true, false>(c, x, y, known[i].data(), int(known[i].size()), nb, &lines[layout.row[i]], width);
            // looked at here too, before connections spread a fault to other components
            if (!finite(&lines[std::size_t(nb) * width + layout.row[i]], c.n_rows)) return {i, start};
        }

        // forces, sample by sample
        for (int b = 0; b < nb; ++b) {
            const double* line = &lines[std::size_t(b) * width];
            for (int p = 0; p < n_ports; ++p) {
                y[p] = line[width + layout.port_rows[p]];
                y[n_ports + p] = line[layout.port_rows[p]];
            }
            std::copy(layout.constant.begin(), layout.constant.end(), f.begin());
            add_product(layout.pull.data(), layout.f_width, y.data(), 2 * n_ports, f.data());
            std::copy(f.begin(), f.begin() + m, job.forces + (start + b) * m);
            double* now = &force[std::size_t(b) * force_width];
            std::fill(now, now + force_width, 0.0);
            add_product(layout.push.data(), force_width, f.data(), m, now);
            spread(layout, now, nb - b, per_row.data(), &lines[std::size_t(b + 1) * width]);
        }

        for (int b = 0; b < nb; ++b)
            for (int o = 0; o < job.n_channels; ++o) {
                const double *w = &solve.weights[std::size_t(o) * m], *fb = job.forces + (start + b) * m;
                double total = 0.0;
                for (int j = 0; j < m; ++j) total += w[j] * fb[j];
                job.out[(start + b) * job.n_channels + o] = total;
            }

        // the correction: inputs known by now move the state; what is driven one way is read on the way
        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            T *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            auto& inputs = known[i];
            const double* forces = &force[layout.port[i]];
            const bool recurs = inputs.empty() && nb == kBlock && c.n_ports <= 2;
            for (int p = 0; p < c.n_ports; ++p)
                inputs.push_back({&c.w[std::size_t(2 * p) * c.n], forces + p, force_width});
            if (!c.driven) {
                if (recurs)
                    recur_store(c, x, y, forces, force_width);
                else
                    turn<T, false, true>(c, x, y, inputs.data(), int(inputs.size()), nb, nullptr, 0);
                continue;
            }
            driven_lines.assign(std::size_t(kBlock + 1) * c.n_rows, 0.0);
            if (recurs && c.n_rows <= c.n_ports + 1) {
                recur_read(c, x, y, driven_lines.data(), c.n_rows);
                respond(layout.driven_history[i].data(), c.n_ports, c.n_rows, forces, force_width, driven_lines.data());
                recur_store(c, x, y, forces, force_width);
            } else {
                turn<T, true, true>(c, x, y, inputs.data(), int(inputs.size()), nb, driven_lines.data(), c.n_rows);
            }
            if (!finite(&driven_lines[std::size_t(nb) * c.n_rows], c.n_rows)) return {i, start};
            emit(c, driven_lines.data(), c.n_rows, start, nb, job);
        }

        for (int i = 0; i < n_components; ++i) {
            const Component<T>& c = components[i];
            if (c.driven) continue;
            const double* rows = &lines[layout.row[i]];
            emit(c, rows, width, start, nb, job);
            if (!finite(rows + std::size_t(nb) * width, c.n_rows)) return {i, start};
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
