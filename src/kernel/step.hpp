// The step, block by block: free motion -> candidates -> forces -> correction.
//
// Within a block a row's value is   y(b) = free(b) + sum_{k < b} H(b - 1 - k) F(k),   H(k) = C E^k W0:
// the modes are passed twice per block however many samples it has, and the forces couple the components in each sample.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "connect/coupled.hpp"
#include "connect/linear_step.hpp"
#include "connect/longitudinal.hpp"
#include "connect/tension_step.hpp"

namespace tonewood {
namespace {

// Flushes denormals to zero while stepping: they cost time in decayed tails.
struct FlushDenormals {
#if defined(__x86_64__)
    unsigned saved = _mm_getcsr();
    FlushDenormals() { _mm_setcsr(saved | 0x8040); }
    ~FlushDenormals() { _mm_setcsr(saved); }
#endif
};

inline bool finite(const double* x, int n, int step = 1) {
    double sum = 0.0;
    for (int i = 0; i < n; ++i) sum += x[i * step];
    return std::isfinite(sum);
}

// Adds a component's readouts to the output.
inline void add_readouts(const Component& c, const double* rows, int stride, int row_stride, const Block& block) {
    const Job& job = block.job;
    const int first = c.driven ? 0 : c.n_ports;
    for (int r = first; r < c.n_rows; ++r) {
        double* out = job.out + block.start * job.n_channels + c.channels[r - first];
        const double* y = rows + std::ptrdiff_t(r) * row_stride;
        const bool difference = c.difference[r - first];
        for (int b = 0; b < block.nb; ++b)
            out[b * job.n_channels] += difference ? y[(b + 1) * stride] - y[b * stride] : y[b * stride];
    }
}

inline std::unique_ptr<ConnectionStep> connection_step(Block& block, ContactStep& laws) {
    const Model& m = block.model;
    if (!m.tensions.strings.empty() && laws.any()) return std::make_unique<CoupledStep>(block, laws);
    if (!m.tensions.strings.empty()) return std::make_unique<TensionStep>(block);
    if (!m.geometric.strings.empty()) return std::make_unique<LongitudinalStep>(block, laws);
    if (m.shortcuts.direct_step && int(m.layout.own_port.size()) == m.solve.m)
        return std::make_unique<DirectStep>(block, laws);
    return std::make_unique<GeneralStep>(block, laws);
}

// Free motion of the two-way components in the row history; a component that is no longer finite, or -1.
inline int free_motion(Block& block) {
    const Layout& l = block.model.layout;
    for (int i = 0; i < int(block.model.components.size()); ++i) {
        const Component& c = block.model.components[i];
        if (c.driven || c.tension.on || c.geometric) continue;
        const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, block.history.data() + l.row[i], l.width, 1};
        const auto& inputs = block.inputs[i];
        if (inputs.empty() && block.nb == kBlock)
            recur_read(c, block.x(i), block.y(i), rows);
        else
            step_modes<true, false>(c, block.x(i), block.y(i), inputs.data(), int(inputs.size()), block.nb, rows);
        // checked here too, before connections spread a fault to other components
        if (!finite(block.line(block.nb) + l.row[i], c.n_rows)) return i;
    }
    return -1;
}

// Moves the modes under the forces of the block and adds the readouts; a component that is no longer finite, or -1.
inline int correct(Block& block, const ContactRows& contacts, Array<double>& driven) {
    const Layout& l = block.model.layout;
    for (int i = 0; i < int(block.model.components.size()); ++i) {
        const Component& c = block.model.components[i];
        double *x = block.x(i), *y = block.y(i);
        const double* forces = block.forces.data() + l.port[i];
        auto& inputs = block.inputs[i];
        const bool recurs = inputs.empty() && block.nb == kBlock, moved = c.tension.on || c.geometric;
        const Ports ports{c.w.data(), c.w_slope.data(), c.n_ports, nullptr, forces, l.force_width, 1};
        const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, driven.data(), 1, kBlock + 1};
        if (!recurs && !moved) {
            for (int p = 0; p < c.n_ports; ++p)
                inputs.push_back({c.w.data() + std::size_t(2 * p) * c.n, forces + p, l.force_width});
            if (block.nb < kBlock) contacts.add_inputs(i, inputs);
        }
        if (c.driven) {
            if (recurs) {
                recur_read(c, x, y, rows);
                respond(l.driven_response[i].data(), c.n_ports, c.n_rows, forces, l.force_width, driven.data());
                recur_store<true>(c, x, y, ports);
            } else {
                step_modes<true, true>(c, x, y, inputs.data(), int(inputs.size()), block.nb, rows);
            }
            if (!finite(driven.data() + block.nb, c.n_rows, kBlock + 1)) return i;
            add_readouts(c, driven.data(), 1, kBlock + 1, block);
            continue;
        }
        if (!moved) {
            if (recurs)
                recur_store<true>(c, x, y, ports);
            else
                step_modes<false, true>(c, x, y, inputs.data(), int(inputs.size()), block.nb, {});
            if (block.nb == kBlock) contacts.move_modes(i, x, y);
        }
        add_readouts(c, block.history.data() + l.row[i], l.width, 1, block);
        if (!finite(block.line(block.nb) + l.row[i], c.n_rows)) return i;
    }
    return -1;
}

inline Fault run(Model& model, const Job& job) {
    const FlushDenormals flush;
    Block block(model, job);
    ContactStep laws(block);
    const auto connections = connection_step(block, laws);
    Propagate propagate(model.layout);
    Array<double> driven;  // rows of a driven component
    for (const Component& c : model.components)
        if (c.driven) driven.resize(std::max(driven.size(), std::size_t(c.n_rows) * (kBlock + 1)));
    for (std::int64_t start = 0; start < job.n; start += kBlock) {
        block.begin(start, int(std::min<std::int64_t>(job.n - start, kBlock)));
        if (const int i = free_motion(block); i >= 0) return {i, start};
        if (laws.any()) laws.cull.begin_block();
        connections->begin_block();
        for (int b = 0; b < block.nb; ++b) {
            double* now = block.force(b);
            if (!connections->sample(b, now, job.forces + (start + b) * model.solve.m)) return {Fault::kUnsolved, start + b};
            propagate(b, block.nb, block.forces.data(), block.history.data());
            if (laws.any()) laws.rows.propagate(b, now);
        }
        connections->finish_block();
        std::fill_n(job.out + start * job.n_channels, block.nb * job.n_channels, 0.0);
        for (const auto& [channel, connection, weight] : model.layout.read_forces)
            for (std::int64_t b = start; b < start + block.nb; ++b)
                job.out[b * job.n_channels + channel] += weight * job.forces[b * model.solve.m + connection];
        laws.add_outputs();
        if (const int i = correct(block, laws.rows, driven); i >= 0) return {i, start};
    }
    laws.finish();
    for (int i = 0; i < int(model.components.size()); ++i)  // those without a readout are checked once per run
        if (const int n = model.components[i].n; !finite(block.x(i), n) || !finite(block.y(i), n)) return {i, job.n};
    return {};
}

}  // namespace
}  // namespace tonewood
