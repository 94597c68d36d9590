// Samples in which tensions rise and nonlinear connections act: both in one system.
//
// For given tensions the step is that of law_forces.hpp with other compliances. Laws that act on fixed ports keep their
// compliances at rest, and the tensions change the displacements of the ports alone (fixed_step); contacts on strings need
// sums over their modes (joint.hpp). Without an active law nothing differs from tension_step.hpp.
#pragma once

#include "joint.hpp"
#include "tension_step.hpp"

namespace tonewood {
namespace {

constexpr double kLawTolerance = 3e-12;  // of the largest force

class CoupledStep : public ConnectionStep {
    using Term = Nonlinear::Term;

public:
    CoupledStep(Block& block, LawForces& laws)
        : block_(block), components_(block.model.components), layout_(block.model.layout), m_(block.model.solve.m),
          nl_(block.model.nonlinear), tensions_(block.model.tensions), on_(block.model.shortcuts),
          ws_(block.model.contacts), ts_(block.model.tension), laws_(laws), linear_(block),
          joint_(block, laws, linear_.passes, linear_.search) {
        laws_.to_state = [this](int i) { linear_.passes.scaled.to_state(i); };
    }

    void begin_block() override { linear_.begin_block(); }
    void finish_block() override { linear_.finish_block(); }

    bool sample(int b, double* now, double* f_out) override {
        double* const f = block_.f.data();
        linear_.passes.begin_sample(b);
        laws_.open_sample(b);
        joint_.begin_sample();
        laws_.compress_candidates(b);
        do {
            if (ws_.active.empty()) {
                if (!linear_.forces(now, f)) return false;
                laws_.rows.clear_forces(b);
            } else if (!(on_.fixed_compliances && on_fixed_ports() && fixed_step(b, f, now)) && !joint_(b, f, now)) {
                return false;
            }
            joint_.invalidate();
            bound_excursions(b);
            laws_.cull.add_candidates(b, laws_.series.find(), [&](int j) { laws_.compress(j, b); });
        } while (close_contacts(b, now));
        laws_.commit(b);
        auto& loads = linear_.passes.loads;
        if (laws_.rows.loads())
            for (const int i : tensions_.components) load(i, b, loads[i]);
        linear_.passes.finish_sample(now);
        for (const int i : tensions_.components) loads[i].clear();
        std::copy_n(f, m_, f_out);
        return true;
    }

private:
    // Whether no law needs sums over modes: no contact on a string, and no friction, whose force may fall as motion grows.
    bool on_fixed_ports() const {
        for (const int j : ws_.active) {
            if (nl_.laws[j].kind == Law::friction) return false;
            for (const Term& t : nl_.terms[j])
                if (t.contact && components_[t.component].tension.on) return false;
        }
        return true;
    }

    // Finds tensions and all forces where laws act on fixed ports of strings: the compliances of the laws are those at
    // rest, and the tensions change the displacements of the ports.
    bool fixed_step(int b, double* f, double* now) {
        TensionPorts& ports = ts_.ports;
        const int n = int(ports.ports.size());
        const double* linear = linear_.passes.linear_part();
        for (const int j : ws_.active) {
            const double free = dot(nl_.from_linear.data() + std::size_t(j) * m_, linear, m_);
            ports.law_free[j] = ws_.rest_p[j] - free;
            ws_.size[j] = std::max(ws_.size[j], std::abs(free));
        }
        gather_active();
        const int a = int(ws_.active.size()), w = int(wide(a));
        int iterations = 0;
        const bool foldable = on_.folded_laws && all_linear();
        const bool done = foldable ? folded(iterations) : linear_.search.find(kLawTolerance, [&](double* force) {
            for (int p = 0; p < n; ++p) ports.sum[p] = ports.alone[p] + ports.moved[p];
            std::fill_n(ports.active_free.data(), w, 0.0);
            add_product(ports.active_meets.data(), w, ports.sum.data(), n, ports.active_free.data());
            for (int i = 0; i < a; ++i)
                ws_.free_p[ws_.active[i]] = ports.law_free[ws_.active[i]] - ports.active_free[i];
            if (!find_forces(nl_, on_, ws_, ws_.z.data(), iterations)) return false;
            for (int i = 0; i < a; ++i) ports.active_force[i] = ws_.law_force[ws_.active[i]];
            add_product(ports.onto_ports.data(), ports.width, ports.moved.data(), n, ports.base.data(), force);
            add_product(ports.active_ports.data(), ports.width, ports.active_force.data(), a, force);
            return true;
        });
        if (!done) return false;
        laws_.count(true, iterations);
        linear_.search.add_moved();
        linear_.linear_forces(f);
        for (const int j : ws_.active) {
            const double* answer = ws_.answer.data() + std::size_t(j) * layout_.f_width;
            for (int q = 0; q < layout_.f_width; ++q) f[q] -= answer[q] * ws_.law_force[j];
        }
        laws_.distribute(b, f, now);
        return true;
    }

    bool all_linear() const {
        if (int(ws_.active.size()) > kMostLinear) return false;
        for (const int j : ws_.active)
            if (!is_linear(nl_.laws[j])) return false;
        return true;
    }

    // Finds tensions and forces where all laws are linear: with force = slope (free - Z force) + given they are further
    // linear connections, and port forces answer displacements by another matrix, kept until a slope changes.
    bool folded(int& iterations) {
        TensionPorts& ports = ts_.ports;
        const int n = int(ports.ports.size()), a = int(ws_.active.size()), w = int(wide(a));
        for (int i = 0; i < a; ++i) {
            const int j = ws_.active[i];
            const LawForce at_zero = evaluate_law(nl_.laws[j], 0.0, ws_.old_p[j], nl_.dt);
            const double slope = at_zero.slope * ws_.scale[j];
            ports.folded = ports.folded && slope == ports.law_slope[i];
            ports.law_slope[i] = slope;
            ports.given[i] = slope * ports.law_free[j] + at_zero.force * ws_.scale[j];
        }
        if (!ports.folded) fold_laws();
        double *const force = ports.active_force.data(), *const fixed = ports.fixed_with_laws.data();
        std::fill_n(force, w, 0.0);
        add_product(ports.answers.data(), w, ports.given.data(), a, force);
        add_product(ports.active_ports.data(), ports.width, force, a, ports.fixed.data(), fixed);
        linear_.search.use(ports.onto_with_laws.data(), fixed);
        const bool done = linear_.search.find_linear();
        linear_.search.use_linear();
        for (int p = 0; p < n; ++p) ports.sum[p] = -(ports.alone[p] + ports.moved[p]);
        add_product(ports.caught.data(), w, ports.sum.data(), n, force);
        for (int i = 0; i < a; ++i) ws_.law_force[ws_.active[i]] = force[i];
        ++iterations;
        return done;
    }

    // Folds the linear laws into the ports' answers, (I + slope Z)^-1 = I + inverse Z.
    void fold_laws() {
        TensionPorts& ports = ts_.ports;
        const int n = int(ports.ports.size()), a = int(ws_.active.size()), width = ports.width;
        const std::size_t w = wide(a);
        double *const z = ws_.matrix.data(), *const answers = ports.answers.data();
        for (int i = 0; i < a; ++i)
            for (int j = 0; j < a; ++j) z[i * w + j] = mutual(ws_.z.data(), nl_.k, ws_.active[i], ws_.active[j]);
        ws_.gathered.clear();
        invert_laws(ws_, z, ports.law_slope.data(), a);
        for (int i = 0; i < a; ++i) {
            std::fill_n(answers + i * w, w, 0.0);
            answers[i * w + i] = 1.0;
            add_product(ws_.inverse.data(), int(w), z + i * w, a, answers + i * w);
        }
        for (int p = 0; p < n; ++p) {
            const double* meets = ports.active_meets.data() + p * w;
            double *const caught = ports.caught.data() + p * w, *const onto = ports.onto_with_laws.data() + std::size_t(p) * width;
            for (int i = 0; i < a; ++i) ports.active_free[i] = ports.law_slope[i] * meets[i];
            std::fill_n(caught, w, 0.0);
            add_product(answers, int(w), ports.active_free.data(), a, caught);
            for (int i = 0; i < a; ++i) ports.active_free[i] = -caught[i];
            add_product(ports.active_ports.data(), width, ports.active_free.data(), a,
                        ports.onto_ports.data() + std::size_t(p) * width, onto);
        }
        ports.folded = true;
    }

    // Displacements that law j sees and forces that it causes on fixed ports of strings, the linear connections answering.
    void find_response(int j) {
        TensionPorts& ports = ts_.ports;
        const std::size_t n = ports.ports.size(), m = m_;
        double *const meets = ports.meets.data() + std::size_t(j) * ports.width, *const forces = ports.law_forces.data();
        std::fill_n(forces, layout_.force_width, 0.0);
        const auto takes = [&](const Term& t) {
            if (t.contact) return;
            forces[layout_.port[t.component] + t.port] += t.factor;
            if (components_[t.component].tension.on) meets[ports.first[t.component] + t.port * ports.strings] += t.factor;
        };
        std::fill_n(meets, ports.width, 0.0);
        for (const Term& t : nl_.terms[j]) takes(t);
        for (const Term& t : nl_.driven[j]) takes(t);
        const double *from_linear = nl_.from_linear.data() + j * m, *answer = ws_.answer.data() + std::size_t(j) * layout_.f_width;
        for (std::size_t t = 0; t < n; ++t) meets[t] += dot(from_linear, ports.onto_linear.data() + t * layout_.f_width, m_);
        for (std::size_t q = 0; q < m; ++q)
            for (int p = 0; p < layout_.force_width; ++p)
                forces[p] -= answer[q] * layout_.scatter[q * layout_.force_width + p];
        for (const int t : ports.real)
            ports.law_ports[std::size_t(j) * ports.width + t] = forces[ports.ports[t].force];
        ports.has_response[j] = 1;
    }

    // Collects these of the active laws.
    void gather_active() {
        TensionPorts& ports = ts_.ports;
        if (ports.active == ws_.active) return;
        ports.active = ws_.active, ports.folded = false;
        const std::size_t n = ports.ports.size(), a = ws_.active.size(), w = wide(int(a)), width = ports.width;
        std::fill_n(ports.active_meets.data(), n * w, 0.0);
        for (std::size_t i = 0; i < a; ++i) {
            const std::size_t j = ws_.active[i];
            if (!ports.has_response[j]) find_response(int(j));
            for (std::size_t p = 0; p < n; ++p) ports.active_meets[p * w + i] = ports.meets[j * width + p];
            std::copy_n(ports.law_ports.data() + j * width, width, ports.active_ports.data() + i * width);
        }
    }

    // Bounds the effect of the tensions on contact rows: T/2 sqrt(sum a (y+ + y)^2) <= T/2 sqrt(2 (S+ + S)), and
    // S+ + S is T / kappa.
    void bound_excursions(int b) {
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            const double T_used = ts_.used[s], kappa = tensions_.strings[s].kappa;
            const double most = T_used > 0.0 ? 0.5 * T_used * std::sqrt(2 * T_used / kappa) * (1 + 1e-4) : 0.0;
            for (const int i : tensions_.strings[s].components) ws_.tension_excursion[std::size_t(i) * kBlock + b] = most;
        }
    }

    // Lists the forces of sample b on contact ports of a component for its modal pass.
    void load(int i, int b, std::vector<Load>& list) {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        list.clear();
        for (const int p : ws_.loaded[i]) {
            const double force = laws_.rows.force(i, p)[b];
            if (force != 0.0) list.push_back({c.contact.rows.data() + 2 * p * n, force});
        }
    }

    // Activates candidates that the motion found closes; whether there are any.
    bool close_contacts(int b, const double* now) {
        return laws_.activate_closed([&](int j) {
            double p = ws_.offset_after[j];
            for (const Term& t : nl_.terms[j]) p -= t.factor * joint_.after(t, b, now);
            return laws_.series.in_motion(j) ? p - ws_.series_after[j] : p;
        });
    }

    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const int m_;
    const Nonlinear& nl_;
    const Tensions& tensions_;
    const Shortcuts& on_;
    ContactState& ws_;
    TensionState& ts_;
    LawForces& laws_;
    TensionStep linear_;
    JointStep joint_;
};

}  // namespace
}  // namespace tonewood
