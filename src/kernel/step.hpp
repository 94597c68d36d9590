// The step, block by block: free motion -> candidates -> forces -> correction.
//
// Within a block a row's value is   y(b) = free(b) + sum_{k < b} H(b - 1 - k) F(k),   H(k) = C E^k W0:
// the modes are passed twice per block however many samples it has, and the forces couple the components in each
// sample.
#pragma once

#include <algorithm>
#include <memory>

#include "connect/general_step.hpp"
#include "connect/potential_step.hpp"
#include "modal/motion.hpp"
#include "potentials/phantom.hpp"

namespace tonewood {
namespace {

inline std::unique_ptr<ConnectionStep> connection_step(Forces& forces) {
    const Model& m = forces.block.model;
    if (forces.potentials) return std::make_unique<PotentialStep>(forces);
    if (m.shortcuts.direct_step && (m.layout.in_parts || int(m.layout.own_port.size()) == m.solve.m))
        return std::make_unique<DirectStep>(forces);
    return std::make_unique<GeneralStep>(forces);
}

inline Fault run(const Model& model, Workspace& space, const Job& job) {
    const FlushDenormals flush;
    Block block(model, space, job);
    Forces forces(block);
    LawForces& laws = forces.laws;
    const auto connections = connection_step(forces);
    Propagate propagate(model.layout);
    PhantomStep phantoms(block);
    Resting resting(block);
    FusedPass fused(block, resting);
    for (std::int64_t start = 0; start < job.n; start += kBlock) {
        block.begin(start, int(std::min<std::int64_t>(job.n - start, kBlock)));
        phantoms.begin_block();
        resting.begin_block();
        if (const int i = free_motion(block, fused, resting); i >= 0) return {i, start};
        if (laws.any()) forces.series.begin_block(), forces.cull.begin_block();
        connections->begin_block();
        for (int b = 0; b < block.nb; ++b) {
            double* now = block.force(b);
            if (!connections->sample(b, now, job.forces + (start + b) * model.solve.m))
                return {Fault::kUnsolved, start + b};
            propagate(b, block.nb, block.forces.data(), block.history.data());
            step_shapes(block, b);
            if (laws.any()) forces.rows.propagate(b, now);
        }
        connections->finish_block();
        std::fill_n(job.out + start * job.n_channels, block.nb * job.n_channels, 0.0);
        for (const auto& [channel, connection, weight] : model.layout.read_forces)
            for (std::int64_t b = start; b < start + block.nb; ++b)
                job.out[b * job.n_channels + channel] += weight * job.forces[b * model.solve.m + connection];
        laws.add_outputs();
        phantoms.finish_block(forces.rows);
        if (const int i = correct(block, forces.rows, fused, resting); i >= 0) return {i, start};
    }
    laws.finish();
    for (int i = 0; i < int(model.components.size()); ++i)  // those without a readout are checked once per run
        if (const int n = model.components[i].n; !finite(block.x(i), n) || !finite(block.y(i), n)) return {i, job.n};
    return {};
}

}  // namespace
}  // namespace tonewood
