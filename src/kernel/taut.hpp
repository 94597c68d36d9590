// The modes of stretched components while a block is stepped.
//
// A mode's first number x and what a step without forces makes of it, u, tell both of its numbers. Kept are
//     xi = x / sqrt(g),     v = (u - x) / sqrt(g),
// g its gain: then one number, half = a g / 2, is all that a tension T needs to know of a mode. A push p moves it by
//     xi+ = xi + v + p,     v+ = det v - kappa xi+ + kick p,
// det and kappa = det(I - E) being those of its matrix E. Sixteen modes lie side by side, what they need in one stream:
// half, det, kappa, kick and a row for each port (derive_taut in prepare.hpp); xi, v, and s = 1 / (1 + half T).
#pragma once

#include "model.hpp"
#include "simd.hpp"

namespace tonewood {
namespace {

class Taut {
public:
    Taut(const std::vector<Component>& components, TensionSpace& space, const Job& job)
        : components_(components), ws_(space), job_(job), is_told_(components.size(), 0) {}

    // (n / 16, 3, 16)
    double* state(int i) const { return ws_.taut.data() + kTautState * components_[i].offset; }

    // From the state of the run.
    void enter(int i) {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        const double *const door = c.stretched.doors.data(), *const x = job_.modes[0] + c.offset,
                *const y = job_.modes[1] + c.offset;
        double* to = state(i);
        for (std::size_t k = 0; k < n; k += kPadding, to += kTautState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V first = S::load(x + k + j);
                S::store(to + j, S::load(door + k + j) * first);
                S::store(to + kPadding + j,
                         S::load(door + n + k + j) * first + S::load(door + 2 * n + k + j) * S::load(y + k + j));
            }
        is_told_[i] = 1;
    }

    // The state of the run is that of now.
    void tell(int i) {
        if (is_told_[i]) return;
        is_told_[i] = 1;
        const Component& c = components_[i];
        const std::size_t n = c.n;
        const double *const door = c.stretched.doors.data() + 3 * n, *from = state(i);
        double *const x = job_.modes[0] + c.offset, *const y = job_.modes[1] + c.offset;
        for (std::size_t k = 0; k < n; k += kPadding, from += kTautState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V xi = S::load(from + j), v = S::load(from + kPadding + j);
                S::store(x + k + j, S::load(door + k + j) * xi);
                S::store(y + k + j, S::load(door + n + k + j) * xi + S::load(door + 2 * n + k + j) * v);
            }
    }

    // s at a tension, divided.
    void yield(int i, double tension) {
        const std::size_t step = std::size_t(kTautNumbers + components_[i].n_ports) * kPadding;
        const double *half = components_[i].stretched.taut.data(), one = 1;
        double* to = state(i) + (kTautState - 1) * kPadding;
        for (int k = 0; k < components_[i].n; k += kPadding, half += step, to += kTautState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) S::store(to + j, one / (one + S::load(half + j) * tension));
    }

    void has_moved(int i) { is_told_[i] = 0; }

private:
    using S = Simd;
    using V = S::V;
    const std::vector<Component>& components_;
    TensionSpace& ws_;
    const Job& job_;
    std::vector<char> is_told_;
};

}  // namespace
}  // namespace tonewood
