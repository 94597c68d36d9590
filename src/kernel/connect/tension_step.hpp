// Samples in which tensions rise: with linear connections alone, or with laws too.
#pragma once

#include <memory>

#include "connection_step.hpp"
#include "linear_laws.hpp"
#include "longitudinal.hpp"
#include "tension.hpp"

namespace tonewood {
namespace {

class TensionStep : public ConnectionStep {
public:
    TensionStep(Block& block, LawForces& laws)
        : block_(block), layout_(block.model.layout), m_(block.model.solve.m), laws_(laws), made_(make(block)),
          tensions_(*made_), direct_(layout_), linear_laws_(block, laws), answering_(layout_.force_width),
          y_(2 * layout_.port_rows.size()), alone_(layout_.f_width) {
        laws_.tensions = &tensions_;
        if (laws_.parts.on()) tensions_.parts = &laws_.parts;
    }

    void begin_block() override {
        tensions_.begin_block();
        linear_laws_.begin_block();
    }
    void finish_block() override { tensions_.finish_block(); }

    bool sample(int b, double* now, double* f_out) override {
        tensions_.begin_sample(b);
        without_tensions(b, now);
        if (linear_laws_.on() && with_linear_laws(b, now, f_out)) {
            finish(b, now);
            return true;
        }
        tensions_.couple(now);
        if (laws_.any() && !laws_.idle(b, [&] { add_tensions(now); })) {
            linear_forces(b);
            if (!laws_.forces(b, block_.f.data(), now)) return false;
            if (laws_.commit(b)) {
                std::copy_n(block_.f.begin(), m_, f_out);
                finish(b, now);
                return true;
            }
            without_tensions(b, now);  // no law acts: the same forces as without laws
            add_tensions(now);
        } else if (!laws_.any()) {
            add_tensions(now);
        }
        if (tensions_.parts) {
            std::copy_n(block_.f.begin(), m_, f_out);
        } else if (layout_.own_port.empty()) {
            linear_forces(b);
            tensions_.add_to_linear(block_.f.data());
            std::copy_n(block_.f.begin(), m_, f_out);
        } else {
            own_forces(layout_, now, m_, f_out);
        }
        finish(b, now);
        return true;
    }

private:
    void finish(int b, const double* now) {
        tensions_.finish_sample(now, [&](int i) { return laws_.loads(i, b); });
    }

    static std::unique_ptr<RisingTensions> make(Block& block) {
        if (block.model.tensions.stretches.empty()) return std::make_unique<ModulatedTensions>(block);
        return std::make_unique<StretchedStrings>(block);
    }

    // Forces of the linear connections on all ports without tensions; in parts, their own in block.f and alone_ as
    // well.
    void without_tensions(int b, double* now) {
        if (!tensions_.parts) return direct_(layout_.direct, block_.line(b), now);
        laws_.parts(block_.line(b), block_.f.data(), now);
        std::copy_n(block_.f.begin(), m_, alone_.begin());
    }
    void add_tensions(double* now) {
        if (!tensions_.parts) return tensions_.add_to_ports(now);
        tensions_.add_to_linear(block_.f.data());
        laws_.parts.scatter(block_.f.data(), now);
    }

    // Linear laws answer as linear connections do; the strings' directions are those without laws, in `now`.
    bool with_linear_laws(int b, double* now, double* f_out) {
        double* const answering = answering_.data();
        std::copy_n(now, layout_.force_width, answering);
        linear_laws_.add(b, answering);
        tensions_.couple(now, answering, linear_laws_.onto_ports());
        tensions_.add_to_ports(answering);
        linear_laws_.answer(tensions_, answering);
        std::swap_ranges(now, now + layout_.force_width, answering);
        if (linear_laws_.commit(b, now, f_out)) return true;
        std::copy_n(answering, layout_.force_width, now);
        return false;
    }

    // Forces of the linear connections without tensions in block.f.
    __attribute__((flatten)) void linear_forces(int b) {
        if (tensions_.parts) return void(std::copy_n(alone_.begin(), m_, block_.f.begin()));
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
    const std::unique_ptr<RisingTensions> made_;
    RisingTensions& tensions_;
    DirectForces direct_;
    LinearLawForces linear_laws_;
    Array<double> answering_;  // (force_width): forces of the linear connections and laws without these strings
    Array<double> y_;          // port displacements before the step, then free ones after it
    Array<double> alone_;      // (f_width): forces of linear connections in parts without these strings
};

}  // namespace
}  // namespace tonewood
