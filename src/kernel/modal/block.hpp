// The block that is being stepped: its row history, port forces and known inputs.
#pragma once

#include <cmath>

#include "../data/state.hpp"

namespace tonewood {
namespace {

struct Block {
    Model& model;
    const Job& job;
    std::int64_t start = 0;  // its first sample in the run
    int nb = 0;              // its samples, at most kBlock
    Array<double> history;   // (kBlock + 1, width): rows at samples 0 .. nb, free motion first, then the motion
    Array<double> forces;    // (kBlock, force_width): on all fixed ports
    Array<double> f;         // (f_width): forces of the linear connections in the sample
    std::vector<std::vector<Input>> inputs;   // by component: known forces
    std::vector<Array<double>> input_values;  // by injection

    Block(Model& m, const Job& j)
        : model(m), job(j), history(std::size_t(kBlock + 1) * m.layout.width),
          forces(std::size_t(kBlock) * m.layout.force_width), f(m.layout.f_width), inputs(m.components.size()),
          input_values(j.injections.size()) {}

    double* line(int b) { return history.data() + std::size_t(b) * model.layout.width; }
    double* force(int b) { return forces.data() + std::size_t(b) * model.layout.force_width; }
    double* x(int i) const { return job.modes[0] + model.components[i].offset; }
    double* y(int i) const { return job.modes[1] + model.components[i].offset; }
    bool modulated(int i) const { return model.components[i].tension.on; }

    // Begins the block of `samples` from `first` and collects the known forces that act in it.
    void begin(std::int64_t first, int samples) {
        start = first, nb = samples;
        for (auto& list : inputs) list.clear();
        for (std::size_t q = 0; q < job.injections.size(); ++q) {
            const Injection& in = job.injections[q];
            if (start + nb <= in.first || start >= in.first + in.length) continue;
            Array<double>& values = input_values[q];
            values.assign(std::size_t(in.n_vectors) * kBlock, 0.0);
            const std::size_t size = 2 * std::size_t(model.components[in.slot].n);
            for (int v = 0; v < in.n_vectors; ++v) {
                for (int b = 0; b < nb; ++b) {
                    const std::int64_t at = start + b - in.first;
                    if (at >= 0 && at < in.length) values[v * kBlock + b] = in.values[v * in.length + at];
                }
                inputs[in.slot].push_back({in.vectors + v * size, values.data() + v * kBlock});
            }
        }
    }
};

}  // namespace
}  // namespace tonewood
