// Modal passes of the strings under rising tension, one per string and sample.
//
// A pass at the predicted tension finishes the step before and sums all that this step needs near that tension
// (modal/tension_pass.hpp). A string whose tension is found too far from the prediction is passed again.
#pragma once

#include "../modal/block.hpp"
#include "../modal/tension_pass.hpp"
#include "products.hpp"

namespace tonewood {
namespace {

constexpr int kWindow = 4;  // blocks over which scaled modes and predictions are kept

class TensionPasses {
    using V = Simd::V;
    static constexpr int kWidth = Simd::width;

public:
    explicit TensionPasses(Block& block)
        : scaled(block.model.components, block.model.tension, block.job), loads(block.model.components.size()),
          block_(block), components_(block.model.components), layout_(block.model.layout),
          tensions_(block.model.tensions), ws_(block.model.tension), ports_(block.model.tension.ports),
          direct_(block.model.layout), part_of_(components_.size(), -1), forces_(ports_.ports.size()) {
        std::size_t n_forces = 0;
        for (int s = 0; s < n_strings(); ++s)
            for (const int i : tensions_.strings[s].components) {
                loads[i].reserve(components_[i].contact.n);
                part_of_[i] = int(parts_.size());
                parts_.push_back({&components_[i], &block.inputs[i], &loads[i], scaled.state(i), lanes(ports_.own[i]),
                                  forces_.data() + n_forces, layout_.port[i], i, s});
                n_forces += components_[i].n_ports;
            }
    }

    ScaledModes scaled;
    std::vector<std::vector<Load>> loads;  // forces on contact ports in the sample, by component

    int n_strings() const { return int(tensions_.strings.size()); }

    // Calls use.operator()<S>(), S the lanes in which strings stand side by side.
    template <class Use>
    auto in_lanes(const Use& use) {
        if (ports_.strings == 1 || !block_.model.shortcuts.tension_lanes) return use.template operator()<Lanes<1>>();
        if constexpr (kWidth > 2)
            if (ports_.strings == 2) return use.template operator()<Lanes<2>>();
        if constexpr (kWidth > 4)
            if (ports_.strings == 4) return use.template operator()<Lanes<4>>();
        return use.template operator()<Simd>();
    }

    // The first block of a window depends on nothing but the state; the others go on from the block before.
    void begin_block() {
        ws_.inverted = false;
        goes_on_ = block_.model.shortcuts.tension_windows && block_.start / kBlock % kWindow != 0;
        if (goes_on_) return;
        for (Part& part : parts_) scaled.from_state(part.slot), part.kept_at = INFINITY;
        for (Array<double>* a : {&ports_.force, &ports_.base}) std::fill(a->begin(), a->end(), 0.0);
        for (int s = 0; s < n_strings(); ++s)
            for (int j = 0; j < 3; ++j) ws_.means[j][s] = block_.job.tension[3 * tensions_.strings[s].index + j];
    }

    // Writes the mean tensions to the state and, where the next block or a readout needs them, the modes, and the rows at
    // the block's end to the history.
    void finish_block() {
        const std::int64_t end = block_.start + block_.nb;
        const bool last = !block_.model.shortcuts.tension_windows || end / kBlock % kWindow == 0 || end == block_.job.n;
        const Nonlinear& nl = block_.model.nonlinear;
        for (Part& part : parts_) {
            if (!last && part.c->n_rows == part.c->n_ports && !(nl.k && nl.group_of[part.slot] >= 0)) continue;
            finish_step(part);
            scaled.to_state(part.slot);
            rows(part.slot, 0, block_.nb);
        }
        for (int s = 0; s < n_strings(); ++s)
            for (int j = 0; j < 3; ++j) block_.job.tension[3 * tensions_.strings[s].index + j] = ws_.means[j][s];
    }

    // Begins sample b: passes all strings, writes their rows, and finds the port forces while their ports do not move.
    void begin_sample(int b) {
        sample_ = b;
        in_lanes([&]<class S>() { predict<S>(); });
        for (int s = 0; s < n_strings(); ++s) pass(s);
        in_lanes([&]<class S>() { reduce<S>(); });
        if (!goes_on_)
            for (int s = 0; s < ports_.strings; ++s)
                ws_.past[s] = ws_.means[0][s] * ports_.over_kappa[s] - ws_.stretch[s];
        double* line = block_.line(b);
        for (const int p : ports_.real) {
            const auto& port = ports_.ports[p];
            line[port.line] = port_sums()[p], line[layout_.width + port.line] = 0.0;
        }
        for (const Part& part : parts_)
            if (part.c->n_rows > part.c->n_ports) scaled.to_state(part.slot), rows(part.slot, part.c->n_ports, b);
        direct_(line, ports_.fixed_part.data());
        for (const int p : ports_.real) ports_.fixed[p] = ports_.fixed_part[ports_.ports[p].force];
        line_ = line;
        linear_known_ = false, goes_on_ = true;
    }

    // Forces of the linear connections while the ports do not move; evaluated once per sample.
    const double* linear_part() {
        if (linear_known_) return ports_.linear.data();
        const int n = int(layout_.port_rows.size());
        for (int p = 0; p < n; ++p) {
            ports_.y[p] = line_[layout_.port_rows[p]];
            ports_.y[n + p] = line_[layout_.width + layout_.port_rows[p]];
        }
        std::copy(layout_.constant.begin(), layout_.constant.end(), ports_.linear.begin());
        add_product(layout_.gather.data(), layout_.f_width, ports_.y.data(), 2 * n, ports_.linear.data());
        linear_known_ = true;
        return ports_.linear.data();
    }

    // Passes a string's modes at the tension ws.at and finishes its pending step.
    void pass(int s) {
        const double at = ws_.at[s];
        PassInput v;
        v.tried = at, v.begun = sample_, v.first = true;
        v.shared = lanes(s), v.next_shared = std::size_t(ports_.strings) * kWidth;
        v.next_own = ports_.ports.size() * kWidth, v.next_port = v.next_shared;
        v.made = ws_.used[s];
        for (const int i : tensions_.strings[s].components) {
            Part& part = parts_[part_of_[i]];
            const Component& c = *part.c;
            v.inputs = part.inputs->data(), v.n_inputs = int(part.inputs->size());
            v.own = part.sums, v.forces = part.forces;
            if (block_.model.shortcuts.combined_pass && part.pending && std::abs(v.made - part.kept_at) * c.tension.largest_half < kExpansion &&
                std::abs(at - v.made) * c.tension.largest_half < kNear) {
                tension_pass<true, true, true>(c, part.state, v);
                scaled.invalidate(i);
                part.pending = false;
            } else {
                finish_step(part);
                move_near(part, at, kNear);
                if (v.n_inputs)
                    tension_pass<false, true, false>(c, part.state, v);
                else
                    tension_pass<false, true, true>(c, part.state, v);
            }
            part.kept_at = at;
            v.first = false;
        }
    }

    // Sums of the passes, those of the same kind side by side.
    template <class S>
    void reduce() {
        double* to = ports_.sums.data();
        const std::size_t n = kSharedSums * std::size_t(ports_.strings) + kPortSums * ports_.ports.size();
        for (std::size_t k = 0; k < n; k += kWidth) Simd::store(to + k, sums<kWidth>(lanes(k)));
        for (int s = 0; s < ports_.strings * kSharedSums; s += S::width) S::store(to + s, 2.0 * S::load(to + s));
        std::copy_n(ports_.sums.data(), ports_.strings, ws_.stretch.begin());
    }

    // The tensions and port forces of the sample are final. Steps with other forces than these are made now.
    void finish_sample(const double* now) {
        std::swap(ws_.means[2], ws_.means[1]), std::swap(ws_.means[1], ws_.means[0]);
        std::copy(ws_.used.begin(), ws_.used.end(), ws_.means[0].begin());
        for (Part& part : parts_) {
            for (int p = 0; p < part.c->n_ports; ++p) part.forces[p] = now[part.port + p];
            part.pending = true;
            if (part.inputs->empty() && part.loads->empty()) continue;
            PassInput v;
            v.made = ws_.used[part.string], v.forces = part.forces, v.made_in = sample_;
            v.inputs = part.inputs->data(), v.n_inputs = int(part.inputs->size());
            v.loads = part.loads->data(), v.n_loads = int(part.loads->size());
            move_near(part, v.made, kExpansion);
            tension_pass<true, false, false>(*part.c, part.state, v);
            scaled.invalidate(part.slot);
            part.kept_at = v.made, part.pending = false;
        }
    }

    // Coordinates before the step in ws.y, and in ws.u their sum with those after it without forces.
    void coordinates(int i) {
        using S = Simd;
        scaled.to_state(i);
        const Component& c = components_[i];
        const int n = c.n;
        const double *const sx = block_.x(i), *const sy = block_.y(i);
        const double* const readings = c.tension.reading.data();
        const double *const e00 = c.e.data(), *const e01 = e00 + n;
        double *const here = buffer(ws_.y, i), *const both = buffer(ws_.u, i);
        for (int k = 0; k < n; k += kWidth) {
            const V a = S::load(sx + k), reading = S::load(readings + k);
            V free = S::load(e00 + k) * a + S::load(e01 + k) * S::load(sy + k);
            for (const Input& in : block_.inputs[i]) free += S::load(in.vector + k) * in.values[sample_ * in.stride];
            S::store(here + k, reading * a);
            S::store(both + k, reading * (a + free));
        }
    }

    double* buffer(Array<double>& all, int i) const { return all.data() + components_[i].offset; }

private:
    struct Part {  // a component under rising tension
        const Component* c;
        const std::vector<Input>* inputs;
        std::vector<Load>* loads;
        double *state, *sums, *forces;
        int port, slot, string;  // its first port among all forces
        bool pending = false;    // its last step is still to be made
        double kept_at = 0.0;    // tension that its s are of
    };
    double* lanes(std::size_t sum) const { return ports_.lanes.data() + sum * kWidth; }
    const double* port_sums() const { return ports_.sums.data() + std::size_t(kSharedSums) * ports_.strings; }
    template <class S>
    static auto of(const Array<double>& a, int p) { return S::load(a.data() + p); }

    // Predicts the tensions as parabolas through the last three stretches S, or mean tensions at a block's beginning.
    template <class S>
    void predict() {
        using V = typename S::V;
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V last = of<S>(ws_.means[0], s), kappa = of<S>(ports_.kappa, s), old = of<S>(ws_.stretch, s);
            V predicted = 3 * (last - of<S>(ws_.means[1], s)) + of<S>(ws_.means[2], s);
            if (goes_on_) {
                const V stretch = last * of<S>(ports_.over_kappa, s) - old;
                const V gone_on = kappa * (stretch + 3 * (stretch - old) + of<S>(ws_.past, s));
                predicted = kappa > 0.0 ? gone_on : predicted;
                S::store(ws_.past.data() + s, old);
            }
            S::store(ws_.at.data() + s, predicted > 0.0 ? predicted : V{});
        }
    }

    // Makes the step that is still pending.
    void finish_step(Part& part) {
        if (!part.pending) return;
        PassInput v;
        v.made = ws_.used[part.string], v.forces = part.forces;
        move_near(part, v.made, kExpansion);
        tension_pass<true, false, true>(*part.c, part.state, v);
        scaled.invalidate(part.slot);
        part.kept_at = v.made, part.pending = false;
    }

    // The reciprocals kept for a component's modes must be of a tension near the next one.
    void move_near(Part& part, double tension, double limit) {
        if (std::abs(tension - part.kept_at) * part.c->tension.largest_half < limit) return;
        scaled.rescale(part.slot, tension);
        part.kept_at = tension;
    }

    // Rows of a component from the first-th on.
    void rows(int i, int first, int b) {
        using S = Simd;
        const Component& c = components_[i];
        double* line = block_.line(b) + layout_.row[i];
        const double *const sx = block_.x(i), *const sy = block_.y(i);
        for (int r = first; r < c.n_rows; ++r) {
            const double *rx = c.rows.data() + 2 * std::size_t(r) * c.n, *ry = rx + c.n;
            V sum{}, more{};
            for (int k = 0; k < c.n; k += kWidth) {
                sum += S::load(rx + k) * S::load(sx + k);
                more += S::load(ry + k) * S::load(sy + k);
            }
            line[r] = S::sum(sum + more);
        }
    }

    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Tensions& tensions_;
    TensionState& ws_;
    TensionPorts& ports_;
    DirectForces direct_;
    std::vector<Part> parts_;   // string by string
    std::vector<int> part_of_;  // by component
    Array<double> forces_;      // on fixed ports, of the step found last
    int sample_ = 0;
    bool linear_known_ = false, goes_on_ = false;
    const double* line_ = nullptr;
};

}  // namespace
}  // namespace tonewood
