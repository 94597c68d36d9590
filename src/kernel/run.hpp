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

#include "geometric.hpp"
#include "lines.hpp"
#include "nonlinear.hpp"
#include "sweep.hpp"
#include "tense_contacts.hpp"
#include "tension.hpp"
#include "weave.hpp"

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
void gather(const Job& job, const std::vector<Component>& components, std::int64_t start, int nb,
            std::vector<std::vector<Input>>& known, std::vector<Array<double>>& values) {
    for (int q = 0; q < job.n_injections; ++q) {
        const Injection& in = job.injections[q];
        if (start + nb <= in.first || start >= in.first + in.length) continue;
        values[q].assign(std::size_t(in.n_vectors) * kBlock, 0.0);
        const std::size_t size = 2 * std::size_t(components[in.slot].n);
        for (int v = 0; v < in.n_vectors; ++v) {
            for (int b = 0; b < nb; ++b) {
                const std::int64_t at = start + b - in.first;
                if (at >= 0 && at < in.length) values[q][v * kBlock + b] = in.values[v * in.length + at];
            }
            known[in.slot].push_back({in.vectors + v * size, values[q].data() + v * kBlock});
        }
    }
}

// Whether a known force acts on a component in the n samples from `start`.
bool touched(const Job& job, int slot, std::int64_t start, std::int64_t n) {
    for (int q = 0; q < job.n_injections; ++q) {
        const Injection& in = job.injections[q];
        if (in.slot == slot && start + n > in.first && start < in.first + in.length) return true;
    }
    return false;
}

inline bool finite(const double* x, int n, int step = 1) {
    double sum = 0.0;
    for (int i = 0; i < n; ++i) sum += x[i * step];
    return std::isfinite(sum);
}

// Adds a component's readouts to the output.
void emit(const Component& c, const double* rows, int stride, int row_stride, std::int64_t start, int nb,
          const Job& job) {
    const int first = c.driven ? 0 : c.n_ports;
    for (int r = first; r < c.n_rows; ++r) {
        double* out = job.out + start * job.n_channels + c.channels[r - first];
        const double* y = rows + std::ptrdiff_t(r) * row_stride;
        if (c.difference[r - first])
            for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[(b + 1) * stride] - y[b * stride];
        else
            for (int b = 0; b < nb; ++b) out[b * job.n_channels] += y[b * stride];
    }
}

Fault run(std::vector<Component>& components, const Layout& layout, const Solve& solve,
          const Nonlinear& nonlinear, const Tensions& tensions, const Geometric& geometric, Workspace& workspace,
          TensionSpace& space, Statistics& statistics, const Job& job) {
    const FlushDenormals guard;
    const int n_components = int(components.size()), m = solve.m, width = layout.width;
    const int force_width = layout.force_width, n_ports = int(layout.port_rows.size());

    Array<double> lines(std::size_t(kBlock + 1) * width);       // rows at samples 0 .. kBlock: free, then moved
    Array<double> next_lines(std::size_t(kBlock + 1) * width);  // free rows of the next block, of what is woven
    Array<double> free_lines;                                   // those of a block that may have to be gone through again
    std::vector<Array<double>> driven_lines(n_components);      // rows of driven components, likewise
    Array<double> forces(std::size_t(kWeave * kBlock) * force_width);  // of ports, a line per sample of a window
    double* force = forces.data();                              // those of the block
    Array<double> f(layout.f_width);
    Spread spread(layout);
    Direct at_once(layout);
    Array<double> y(2 * n_ports);  // port displacements at the step's beginning, then free at its end
    std::vector<std::vector<Input>> known(n_components);
    std::vector<Array<double>> known_values(job.n_injections);
    Taut taut(components, space, job);
    NonlinearStep laws(components, layout, solve, nonlinear, tensions, workspace, statistics, job, known, taut);
    TensionStep stretched(components, layout, solve, tensions, space, statistics, job, known, taut);
    TenseContacts both(components, layout, solve, nonlinear, tensions, workspace, space, statistics, laws, stretched);
    GeometricStep along(components, layout, geometric, statistics, job);
    const bool tense = !tensions.strings.empty(), longitudinal = !geometric.strings.empty();
    const bool direct = !tense && !longitudinal && int(layout.own_port.size()) == m;

    // Forces of sample b from the lines at its beginning and, free of them, at its end.
    const auto connect = [&](int b, double* now) {
        const double* line = lines.data() + std::size_t(b) * width;
        for (int p = 0; p < n_ports; ++p) {
            y[p] = line[layout.port_rows[p]];
            y[n_ports + p] = line[width + layout.port_rows[p]];
        }
        std::copy(layout.constant.begin(), layout.constant.end(), f.begin());
        add_product(layout.pull.data(), layout.f_width, y.data(), 2 * n_ports, f.data());
        if (nonlinear.k) return laws.forces(b, f.data(), now);
        std::fill(now, now + force_width, 0.0);
        add_product(layout.push.data(), force_width, f.data(), m, now);
        return true;
    };

    std::vector<char> woven(n_components, 0), to_weave = woven;
    Loom loom(components, layout, forces.data(), job);
    for (int i = 0; i < n_components; ++i)
        if (components[i].driven) driven_lines[i].assign(std::size_t(kBlock + 1) * components[i].n_rows, 0.0);

    // The modes of what is woven stand where they went in; a string of one port follows to the block's beginning if it is
    // asked for in between, and may leave the loom there.
    int place = 0;  // of the block between going in and coming out
    bool left = false;
    std::vector<int> followed(n_components, 0);
    laws.follow = [&](int i) {
        const Component& c = components[i];
        if (!woven[i]) return;
        for (int& q = followed[i]; q < place; ++q) {
            const double* then = forces.data() + std::size_t(q) * kBlock * force_width + layout.port[i];
            recur_store<true>(c, job.modes[0] + c.offset, job.modes[1] + c.offset,
                                 {c.w.data(), c.w_slope.data(), c.n_ports, nullptr, then, force_width, 1});
        }
    };
    laws.leave = [&](int i) {
        if (!woven[i]) return;
        laws.follow(i);
        woven[i] = 0, left = true;
    };

    for (std::int64_t start = 0; start < job.n; start += kBlock) {
        place = int(start / kBlock % kWeave);
        force = forces.data() + std::size_t(place) * kBlock * force_width;
        if (place == 0) {
            const bool whole = start + kWeave * kBlock <= job.n;
            const auto may = [&](int i) {
                const Component& c = components[i];
                return whole && !c.woven.chunks.empty() && !c.geometric && !touched(job, i, start, kWeave * kBlock);
            };
            laws.begin_window(whole, !longitudinal, may);
            for (int i = 0; i < n_components; ++i)
                to_weave[i] = (!components[i].guarded.n || laws.calm(i)) && may(i) && !components[i].stretched.on;
            std::fill(followed.begin(), followed.end(), 0);
            if (to_weave != woven) loom.set(woven = to_weave);
            loom.pass<Passage::in>(0);
            loom.unwind(lines.data(), driven_lines, 0);
        } else {
            lines.swap(next_lines);
        }
        const int nb = int(job.n - start < kBlock ? job.n - start : kBlock);
        for (auto& list : known) list.clear();
        gather(job, components, start, nb, known, known_values);

        for (int i = 0; i < n_components; ++i) {
            Component& c = components[i];
            if (c.driven || c.stretched.on || c.geometric) continue;
            double *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, lines.data() + layout.row[i], width, 1};
            if (!woven[i]) {
                if (known[i].empty() && nb == kBlock)
                    recur_read(c, x, y, rows);
                else
                    turn<true, false>(c, x, y, known[i].data(), int(known[i].size()), nb, rows);
            }
            // looked at here too, before connections spread a fault to other components
            if (!finite(lines.data() + std::size_t(nb) * width + layout.row[i], c.n_rows)) return {i, start};
        }
        if (nonlinear.k) laws.begin_block(start, nb, lines.data(), force);

        if (tense) stretched.begin_block(place > 0);
        // forces, sample by sample; where nothing is expected to touch anything, that is looked at in the end
        bool asks = !(direct && nonlinear.k && laws.may_stay());
        if (!asks) free_lines = lines;
        for (int b = 0; b < nb; ++b) {
            double* now = force + std::size_t(b) * force_width;
            double* const f_out = job.forces + (start + b) * m;
            bool acts = false;
            if (tense) {
                const bool found = nonlinear.k ? both.step(b, lines.data(), f.data(), now)
                                               : stretched.step(b, lines.data(), f.data(), now);
                if (!found) return {Fault::kUnsolved, start + b};
            } else if (direct) {
                // what acts nonlinearly, if anything does, is told by the other way
                const double* line = lines.data() + std::size_t(b) * width;
                at_once(line, now);
                if (nonlinear.k && asks && !laws.stays_still(b, now)) {
                    if (!connect(b, now)) return {Fault::kUnsolved, start + b};
                    acts = laws.commit(b);
                    if (!acts) at_once(line, now);
                }
                if (acts)
                    std::copy(f.begin(), f.begin() + m, f_out);
                else if (layout.own_in_order)
                    for (int j = 0; j < m; ++j) f_out[j] = layout.own_factor[j] * now[j];
                else
                    for (int j = 0; j < m; ++j) f_out[j] = layout.own_factor[j] * now[layout.own_port[j]];
            } else if (longitudinal) {
                along.begin_sample(b, lines.data(), known);
                const bool found = laws.keeping_branches([&] {
                    return along.solve(b, lines.data(), now, [&](double* to) { return connect(b, to); });
                });
                if (!found) return {Fault::kUnsolved, start + b};
                if (nonlinear.k) laws.commit(b);
                along.finish_sample(now);
            } else {
                if (!connect(b, now)) return {Fault::kUnsolved, start + b};
                if (nonlinear.k) laws.commit(b);
            }
            if (!direct) std::copy(f.begin(), f.begin() + m, f_out);
            spread(b, nb, force, lines.data());
            if (nonlinear.k) laws.push_on(b, now);
            if (!asks && b + 1 == nb && !laws.stayed()) {
                std::copy(free_lines.begin(), free_lines.end(), lines.begin());
                asks = true, b = -1;
            }
        }

        std::fill_n(job.out + start * job.n_channels, nb * job.n_channels, 0.0);
        for (const auto& [channel, connection, weight] : layout.heard)
            for (int b = 0; b < nb; ++b)
                job.out[(start + b) * job.n_channels + channel] += weight * job.forces[(start + b) * m + connection];
        laws.emit(start, nb);
        if (tense) {
            const bool all = place + 1 == kWeave || start + nb == job.n;
            stretched.finish_block(nb, [&](int i) { return all || laws.asks(i); }, lines.data());
        }
        if (longitudinal) along.finish_block(nb, lines.data());

        // the correction: inputs known by now move the state; what is driven one way is read on the way
        for (int i = 0; i < n_components; ++i) {
            Component& c = components[i];
            if (c.stretched.on || c.geometric) continue;
            double *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            auto& inputs = known[i];
            const double* pushes = force + layout.port[i];
            const bool recurs = inputs.empty() && nb == kBlock;
            const Ports ports{c.w.data(), c.w_slope.data(), c.n_ports, nullptr, pushes, force_width, 1};
            const auto answer = [&](double* to) {
                respond(layout.driven_history[i].data(), c.n_ports, c.n_rows, pushes, force_width, to);
            };
            if (!c.driven && woven[i]) continue;
            if (!(recurs && woven[i]))
                for (int p = 0; p < c.n_ports; ++p)
                    inputs.push_back({c.w.data() + std::size_t(2 * p) * c.n, pushes + p, force_width});
            if (nb < kBlock) laws.add_inputs(i, inputs);
            if (!c.driven) {
                if (recurs)
                    recur_store<true>(c, x, y, ports);
                else
                    turn<false, true>(c, x, y, inputs.data(), int(inputs.size()), nb, {});
                if (nb == kBlock) laws.push_modes(i, x, y);
                continue;
            }
            double* const driven = driven_lines[i].data();
            const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, driven, 1, kBlock + 1};
            if (woven[i]) {
                answer(driven);
            } else if (recurs) {
                recur_read(c, x, y, rows);
                answer(driven);
                recur_store<true>(c, x, y, ports);
            } else {
                turn<true, true>(c, x, y, inputs.data(), int(inputs.size()), nb, rows);
            }
            if (!finite(driven + nb, c.n_rows, kBlock + 1)) return {i, start};
            emit(c, driven, 1, kBlock + 1, start, nb, job);
        }
        if (left) loom.set(woven);
        left = false;
        if (place + 1 == kWeave) {
            loom.pass<Passage::out>(force - forces.data());
        } else {
            for (int i = 0; i < n_components; ++i) {
                const Component& c = components[i];
                if (!woven[i]) continue;
                double* const rows = c.driven ? driven_lines[i].data() : next_lines.data() + layout.row[i];
                const double* const last = c.driven ? rows + kBlock : lines.data() + kBlock * width + layout.row[i];
                const int step = c.driven ? kBlock + 1 : 1;
                for (int r = 0; r < c.n_rows; ++r) rows[r * step] = last[r * step];
            }
            loom.pass<Passage::on>(force - forces.data());
            loom.unwind(next_lines.data(), driven_lines, 1);
        }

        for (int i = 0; i < n_components; ++i) {
            const Component& c = components[i];
            if (c.driven) continue;
            const double* rows = lines.data() + layout.row[i];
            emit(c, rows, width, 1, start, nb, job);
            if (!finite(rows + std::size_t(nb) * width, c.n_rows)) return {i, start};
        }
    }
    laws.finish();
    // a component that nothing reads is looked at once per run
    for (int i = 0; i < n_components; ++i) {
        const Component& c = components[i];
        double check = 0.0;
        for (int k = 0; k < c.n; ++k) check += job.modes[0][c.offset + k] + job.modes[1][c.offset + k];
        if (!std::isfinite(check)) return {i, job.n};
    }
    return {};
}

}  // namespace
}  // namespace tonewood
