// Modes of components under rising tension while a block is stepped, in scaled coordinates.
//
// A mode's first number x and its value u after a step without forces determine both of its numbers. The state is
//     xi = x / sqrt(g),     v = (u - x) / sqrt(g),
// g the mode's gain. A modal force p moves the mode by
//     xi+ = xi + v + p,     v+ = det v - kappa xi+ + kick p,
// det and kappa = det(I - E) those of its matrix E. Sixteen modes lie side by side in two streams: h p_0 and
// h p_1 (tension_pass.hpp), det, kappa, kick, and a row for each port (derive_scaled in load/component.hpp); xi and v.
#pragma once

#include "../data/state.hpp"
#include "simd.hpp"

namespace tonewood {
namespace {

class ScaledModes {
public:
    ScaledModes(const std::vector<Component>& components, PotentialState& space, const Job& job)
        : components_(components), ws_(space), job_(job), in_state_(components.size(), 0) {}

    // (n / 16, 2, 16)
    double* state(int i) const { return ws_.scaled.data() + kScaledState * components_[i].offset; }

    // Reads the modes from the state of the run.
    void from_state(int i) {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        const double *const basis = c.coordinates.basis.data(), *const x = job_.modes[0] + c.offset,
                *const y = job_.modes[1] + c.offset;
        double* to = state(i);
        for (std::size_t k = 0; k < n; k += kPadding, to += kScaledState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V first = S::load(x + k + j);
                S::store(to + j, S::load(basis + k + j) * first);
                S::store(to + kPadding + j,
                         S::load(basis + n + k + j) * first + S::load(basis + 2 * n + k + j) * S::load(y + k + j));
            }
        in_state_[i] = 1;
    }

    // Writes the modes to the state of the run, unless it has them.
    void to_state(int i) {
        if (in_state_[i]) return;
        in_state_[i] = 1;
        const Component& c = components_[i];
        const std::size_t n = c.n;
        const double *const basis = c.coordinates.basis.data() + 3 * n, *from = state(i);
        double *const x = job_.modes[0] + c.offset, *const y = job_.modes[1] + c.offset;
        for (std::size_t k = 0; k < n; k += kPadding, from += kScaledState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V xi = S::load(from + j), v = S::load(from + kPadding + j);
                S::store(x + k + j, S::load(basis + k + j) * xi);
                S::store(y + k + j, S::load(basis + n + k + j) * xi + S::load(basis + 2 * n + k + j) * v);
            }
    }

    void invalidate(int i) { in_state_[i] = 0; }

private:
    using S = Simd;
    using V = S::V;
    const std::vector<Component>& components_;
    PotentialState& ws_;
    const Job& job_;
    std::vector<char> in_state_;
};

}  // namespace
}  // namespace tonewood
