// The two ends of a block: the free motion of the rows, and the motion of the modes under the forces found.
#pragma once

#include "../cull/contact_rows.hpp"
#include "fused_pass.hpp"
#include "shape_step.hpp"

namespace tonewood {
namespace {

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

// Free motion of the two-way components in the row history; a component that is no longer finite, or -1.
inline int free_motion(Block& block, FusedPass& fused, const Resting& resting) {
    fused.begin_block();
    const Layout& l = block.model.layout;
    for (int i = 0; i < int(block.model.components.size()); ++i) {
        const Component& c = block.model.components[i];
        if (c.driven || c.by_sample() || resting[i]) continue;
        const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, block.history.data() + l.row[i], l.width, 1};
        const auto& inputs = block.inputs[i];
        if (l.stepped[i]) {
            ShapeStep(c, block.x(i), block.y(i), inputs).begin(block.line(0) + l.row[i], block.line(1) + l.row[i]);
            continue;
        }
        if (!fused[i] && inputs.empty() && block.nb == kBlock)
            c.ratio.empty() ? recur_read(c, block.x(i), block.y(i), rows)
                            : recur_read<true>(c, block.x(i), block.y(i), rows);
        else if (!fused[i])
            step_modes<true, false>(c, block.x(i), block.y(i), inputs.data(), int(inputs.size()), block.nb, rows);
        // checked here too, before connections spread a fault to other components
        if (!finite(block.line(block.nb) + l.row[i], c.n_rows)) return i;
    }
    return -1;
}

// Moves the components that are stepped sample by sample by sample b, whose forces are known.
inline void step_shapes(Block& block, int b) {
    const Layout& l = block.model.layout;
    for (const int i : l.sample_by_sample)
        ShapeStep(block.model.components[i], block.x(i), block.y(i), block.inputs[i])
            .sample(b, block.force(b) + l.port[i], block.line(b + 1) + l.row[i],
                    b + 1 < block.nb ? block.line(b + 2) + l.row[i] : nullptr);
}

// Moves the modes under the forces of the block and adds the readouts; a component that is no longer finite, or -1.
inline int correct(Block& block, const ContactRows& contacts, FusedPass& fused, const Resting& resting) {
    const Layout& l = block.model.layout;
    for (int i = 0; i < int(block.model.components.size()); ++i) {
        if (resting[i]) continue;
        const Component& c = block.model.components[i];
        double *x = block.x(i), *y = block.y(i);
        const double* forces = block.forces.data() + l.port[i];
        auto& inputs = block.inputs[i];
        const bool recurs = inputs.empty() && block.nb == kBlock;
        const bool moved = c.by_sample() || l.stepped[i] || (fused[i] && !c.driven);
        double* const driven = c.driven ? fused.driven_rows(i) : nullptr;
        const Ports ports{c.w.data(), c.w_slope.data(), c.n_ports, nullptr, forces, l.force_width, 1};
        const Rows rows{c.rows.data(), c.slopes.data(), c.n_rows, nullptr, driven, 1, kBlock + 1};
        if (!recurs && !moved) {
            for (int p = 0; p < c.n_ports; ++p)
                inputs.push_back({c.w.data() + std::size_t(2 * p) * c.n, forces + p, l.force_width});
            if (block.nb < kBlock) contacts.add_inputs(i, inputs);
        }
        if (c.driven) {
            if (recurs) {
                if (!fused[i]) recur_read(c, x, y, rows);
                respond(l.driven_response[i].data(), c.n_ports, c.n_rows, forces, l.force_width, driven);
                if (!fused[i]) recur_store<true>(c, x, y, ports);
            } else {
                step_modes<true, true>(c, x, y, inputs.data(), int(inputs.size()), block.nb, rows);
            }
            if (c.n_rows && !finite(driven + block.nb, c.n_rows, kBlock + 1)) return i;
            add_readouts(c, driven, 1, kBlock + 1, block);
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
    fused.finish_block();
    return -1;
}

}  // namespace
}  // namespace tonewood
