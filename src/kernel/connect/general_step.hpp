// Steps without potentials: any connections, and linear ones alone.
#pragma once

#include "connection_step.hpp"
#include "linear_laws.hpp"

namespace tonewood {
namespace {

// Any connections: forces of the linear ones from the gaps, then the laws.
class GeneralStep : public ConnectionStep {
public:
    explicit GeneralStep(Forces& forces)
        : block_(forces.block), layout_(block_.model.layout), m_(block_.model.solve.m), laws_(forces.laws),
          parts_(forces.parts), y_(2 * layout_.port_rows.size()) {}

    bool sample(int b, double* now, double* f_out) override {
        if (!forces(b, now)) return false;
        laws_.commit(b);
        std::copy_n(block_.f.begin(), m_, f_out);
        return true;
    }

    // Forces of sample b in block.f and `now`; they are not final.
    // Flattened, because compilers do not inline products that several callers use.
    __attribute__((flatten)) bool forces(int b, double* now) {
        if (parts_.on()) {
            parts_(block_.line(b), block_.f.data(), now);
            return laws_.any() ? laws_.forces(b, block_.f.data(), now) : true;
        }
        const int n = int(layout_.port_rows.size());
        const double* line = block_.line(b);
        double* const f = block_.f.data();
        for (int p = 0; p < n; ++p) {
            y_[p] = line[layout_.port_rows[p]];
            y_[n + p] = line[layout_.width + layout_.port_rows[p]];
        }
        std::copy(layout_.constant.begin(), layout_.constant.end(), f);
        add_product(layout_.gather.data(), layout_.f_width, y_.data(), 2 * n, f);
        if (laws_.any()) return laws_.forces(b, f, now);
        std::fill_n(now, layout_.force_width, 0.0);
        add_product(layout_.scatter.data(), layout_.force_width, f, m_, now);
        return true;
    }

private:
    Block& block_;
    const Layout& layout_;
    const int m_;
    LawForces& laws_;
    ForcesInParts& parts_;
    Array<double> y_;  // port displacements before the step, then free ones after it
};

// The port forces of linear connections in one product. The general step follows only where a contact may touch.
class DirectStep : public ConnectionStep {
public:
    explicit DirectStep(Forces& forces)
        : block_(forces.block), layout_(block_.model.layout), m_(block_.model.solve.m), laws_(forces.laws),
          cull_(forces.cull), parts_(forces.parts), general_(forces), direct_(layout_), linear_laws_(forces) {}

    void begin_block() override { linear_laws_.begin_block(); }

    bool sample(int b, double* now, double* f_out) override {
        if (linear_laws_.on()) {
            direct_(layout_.direct, block_.line(b), now);
            linear_laws_.add(b, now);
            if (linear_laws_.commit(b, now, f_out)) return true;
        }
        const double* line = block_.line(b);
        const auto direct = [&] {
            if (parts_.on()) parts_(line, block_.f.data(), now);
            else direct_(layout_.direct, line, now);
        };
        const bool may_skip = !laws_.any() || cull_.contact_free_so_far();
        if (may_skip) direct();
        if (may_skip && (!laws_.any() || cull_.contact_free(b, now))) {
            laws_.commit_contact_free();
        } else {
            if (!general_.forces(b, now)) return false;
            if (laws_.commit(b)) {
                std::copy_n(block_.f.begin(), m_, f_out);
                return true;
            }
            direct();  // no law acts: the same port forces as without laws
        }
        if (parts_.on()) std::copy_n(block_.f.begin(), m_, f_out);
        else own_forces(layout_, now, m_, f_out);
        return true;
    }

private:
    Block& block_;
    const Layout& layout_;
    const int m_;
    LawForces& laws_;
    BroadPhase& cull_;
    ForcesInParts& parts_;
    GeneralStep general_;
    DirectForces direct_;
    LinearLawForces linear_laws_;
};

}  // namespace
}  // namespace tonewood
