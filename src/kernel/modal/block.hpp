// The block that is being stepped: its row history, port forces and known inputs.
#pragma once

#include <cmath>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "../data/state.hpp"

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

struct Block {
    const Model& model;
    Workspace& space;
    const Job& job;
    std::int64_t start = 0;  // its first sample in the run
    int nb = 0;              // its samples, at most kBlock
    Array<double> history;   // (kBlock + 1, width): rows at samples 0 .. nb, free motion first, then the motion
    Array<double> forces;    // (kBlock, force_width): on all fixed ports
    Array<double> f;         // (f_width): forces of the linear connections in the sample
    std::vector<std::vector<Input>> inputs;   // by component: known forces
    std::vector<Array<double>> input_values;  // by injection
    std::vector<int> known;                   // components on which a known force acts all the time

    Block(const Model& m, Workspace& w, const Job& j)
        : model(m), space(w), job(j), history(std::size_t(kBlock + 1) * m.layout.width),
          forces(std::size_t(kBlock) * m.layout.force_width + kLane), f(m.layout.f_width + kLane),
          inputs(m.components.size()), input_values(j.injections.size()) {}

    double* line(int b) { return history.data() + std::size_t(b) * model.layout.width; }
    double* force(int b) { return forces.data() + std::size_t(b) * model.layout.force_width; }
    double* x(int i) const { return job.modes[0] + model.components[i].offset; }
    double* y(int i) const { return job.modes[1] + model.components[i].offset; }
    bool modulated(int i) const { return model.components[i].modulated; }

    // Whether a known force acts on component i in the next n samples.
    bool forced(int i, std::int64_t n) const {
        for (const int slot : known)
            if (slot == i) return true;
        for (const Injection& in : job.injections)
            if (in.slot == i && start + n > in.first && start < in.first + in.length) return true;
        return false;
    }

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
                bool acts = false;
                for (int b = 0; b < nb; ++b) {
                    const std::int64_t at = start + b - in.first;
                    if (at < 0 || at >= in.length) continue;
                    values[v * kBlock + b] = in.values[v * in.length + at];
                    acts = acts || values[v * kBlock + b] != 0.0;
                }
                if (acts) inputs[in.slot].push_back({in.vectors + v * size, values.data() + v * kBlock});
            }
        }
    }
};

}  // namespace
}  // namespace tonewood
