// Static states of components under the means of their known forces.
//
// A constant force f holds the modes at (I - E)^-1 W f. Bounds are put on the motion about that state, not on the whole
// motion: a string that is displaced slowly moves little about it, however large the displacement.
#pragma once

#include <deque>

#include "row_bounds.hpp"

namespace tonewood {
namespace {

class HeldStates {
public:
    explicit HeldStates(Block& block) : block_(block), states_(block.model.components.size()) {}

    // Subtracts from the state of component i its static state under the mean forces of the block. Returns a bound on the
    // change of its norm by the deviations of the forces from their means.
    double begin_block(int i) {
        const Component& c = block_.model.components[i];
        const std::size_t n = c.n;
        State& state = states_[i];
        state.modes.assign(block_.x(i), block_.x(i) + n);
        state.modes.insert(state.modes.end(), block_.y(i), block_.y(i) + n);
        state.rows.assign(c.contact.n, 0.0);
        double added = 0.0;
        for (const Input& input : block_.inputs[i]) {
            const Held& held = held_by(c, input.vector);
            double mean = 0.0, off = 0.0;
            for (int b = 0; held.exists && b < block_.nb; ++b) mean += input.values[b] / block_.nb;
            for (int b = 0; b < block_.nb; ++b) off += std::abs(input.values[b] - mean);
            for (std::size_t k = 0; k < 2 * n; ++k) state.modes[k] -= held.modes[k] * mean;
            for (int r = 0; r < c.contact.n; ++r) state.rows[r] += mean * held.rows[r];
            added += off * held.norm;
        }
        return added;
    }

    // The modes relative to the static state, and the contact rows of the static state.
    const double* x(int i) const { return block_.inputs[i].empty() ? block_.x(i) : states_[i].modes.data(); }
    const double* y(int i) const {
        return block_.inputs[i].empty() ? block_.y(i) : states_[i].modes.data() + block_.model.components[i].n;
    }
    double row(int i, int port) const { return block_.inputs[i].empty() ? 0.0 : states_[i].rows[port]; }

private:
    struct State {
        Array<double> modes, rows;
    };
    struct Held {
        const double* vector;
        Array<double> modes, rows;  // per newton
        double norm;                // of the state after one step under one newton
        bool exists;                // no mode drifts under the force
    };

    const Held& held_by(const Component& c, const double* vector) {
        for (const Held& held : held_)
            if (held.vector == vector) return held;
        const std::size_t n = c.n;
        Held held{vector, Array<double>(2 * n), Array<double>(c.contact.n), norm(c, vector, vector + n), true};
        for (std::size_t k = 0; k < n; ++k) {
            const double x = vector[k], y = vector[n + k], kappa = c.kappa[k];
            held.exists = held.exists && (kappa > 0.0 || (x == 0.0 && y == 0.0));
            if (!(kappa > 0.0)) continue;
            held.modes[k] = ((1.0 - c.e[3 * n + k]) * x + c.e[n + k] * y) / kappa;
            held.modes[n + k] = (c.e[2 * n + k] * x + (1.0 - c.e[k]) * y) / kappa;
        }
        for (int r = 0; r < c.contact.n; ++r)
            for (std::size_t k = 0; k < 2 * n; ++k)
                held.rows[r] += c.contact.rows[2 * std::size_t(r) * n + k] * held.modes[k];
        return held_.emplace_back(std::move(held));
    }

    Block& block_;
    std::vector<State> states_;  // by component
    std::deque<Held> held_;      // of this run
};

}  // namespace
}  // namespace tonewood
