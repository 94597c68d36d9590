// Samples in which potentials act: with linear connections alone, or with laws too.
#pragma once

#include "connection_step.hpp"
#include "linear_laws.hpp"

namespace tonewood {
namespace {

class PotentialStep : public ConnectionStep {
public:
    explicit PotentialStep(Forces& forces)
        : block_(forces.block), layout_(block_.model.layout), m_(block_.model.solve.m), laws_(forces.laws),
          parts_(forces.parts), potentials_(*forces.potentials), direct_(layout_), linear_laws_(forces),
          answering_(layout_.force_width), y_(2 * layout_.port_rows.size()), alone_(layout_.f_width) {}

    void begin_block() override {
        potentials_.begin_block();
        linear_laws_.begin_block();
    }
    void finish_block() override { potentials_.finish_block(); }

    bool sample(int b, double* now, double* f_out) override {
        potentials_.begin_sample(b);
        without_potentials(b, now);
        if (linear_laws_.on() && with_linear_laws(b, now, f_out)) {
            finish(b, now);
            return true;
        }
        potentials_.couple(now);
        if (laws_.any() && !laws_.idle(b, [&] { add_potentials(now); })) {
            linear_forces(b);
            if (!laws_.forces(b, block_.f.data(), now)) return false;
            if (laws_.commit(b)) {
                std::copy_n(block_.f.begin(), m_, f_out);
                finish(b, now);
                return true;
            }
            without_potentials(b, now);  // no law acts: the same forces as without laws
            add_potentials(now);
        } else if (!laws_.any()) {
            add_potentials(now);
        }
        if (potentials_.in_parts()) {
            std::copy_n(block_.f.begin(), m_, f_out);
        } else if (layout_.own_port.empty()) {
            linear_forces(b);
            potentials_.add_to_linear(block_.f.data());
            std::copy_n(block_.f.begin(), m_, f_out);
        } else {
            own_forces(layout_, now, m_, f_out);
        }
        finish(b, now);
        return true;
    }

private:
    void finish(int b, const double* now) {
        potentials_.finish_sample(now, [&](int i) { return laws_.loads(i, b); });
    }

    // Forces of the linear connections on all ports without potentials; in parts, their own in block.f and alone_ as
    // well.
    void without_potentials(int b, double* now) {
        if (!potentials_.in_parts()) return direct_(layout_.direct, block_.line(b), now);
        parts_(block_.line(b), block_.f.data(), now);
        std::copy_n(block_.f.begin(), m_, alone_.begin());
    }
    void add_potentials(double* now) {
        if (!potentials_.in_parts()) return potentials_.add_to_ports(now);
        potentials_.add_to_linear(block_.f.data());
        parts_.scatter(block_.f.data(), now);
    }

    // Linear laws answer as linear connections do; the directions are those without laws, in `now`.
    bool with_linear_laws(int b, double* now, double* f_out) {
        double* const answering = answering_.data();
        std::copy_n(now, layout_.force_width, answering);
        linear_laws_.add(b, answering);
        potentials_.couple(now, answering, linear_laws_.onto_ports());
        potentials_.add_to_ports(answering);
        linear_laws_.answer(potentials_, answering);
        std::swap_ranges(now, now + layout_.force_width, answering);
        if (linear_laws_.commit(b, now, f_out)) return true;
        std::copy_n(answering, layout_.force_width, now);
        return false;
    }

    // Forces of the linear connections without potentials in block.f.
    __attribute__((flatten)) void linear_forces(int b) {
        if (potentials_.in_parts()) return void(std::copy_n(alone_.begin(), m_, block_.f.begin()));
        const int n = int(layout_.port_rows.size());
        const double* line = block_.line(b);
        for (int p = 0; p < n; ++p) {
            y_[p] = line[layout_.port_rows[p]];
            y_[n + p] = line[layout_.width + layout_.port_rows[p]];
        }
        std::copy(layout_.constant.begin(), layout_.constant.end(), block_.f.begin());
        add_product(layout_.gather.data(), layout_.f_width, y_.data(), 2 * n, block_.f.data());
    }

    Block& block_;
    const Layout& layout_;
    const int m_;
    LawForces& laws_;
    ForcesInParts& parts_;
    PotentialSolve& potentials_;
    DirectForces direct_;
    LinearLawForces linear_laws_;
    Array<double> answering_;  // (force_width): forces of the linear connections and laws without potentials
    Array<double> y_;          // port displacements before the step, then free ones after it
    Array<double> alone_;      // (f_width): forces of linear connections in parts without potentials
};

}  // namespace
}  // namespace tonewood
