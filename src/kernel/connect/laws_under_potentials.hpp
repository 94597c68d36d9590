// How potentials answer to the forces of nonlinear laws: gaps move by psi_m, and psi_m by the laws' forces.
//
// With d_j the gap of law j per psi_m of each potential and M of potentials/solve.hpp, a gap moves by -d . psi_m, and
// the gaps per force become z - d M^-1 d^T / 2.
#pragma once

#include "../cull/contact_rows.hpp"
#include "../potentials/solve.hpp"

namespace tonewood {
namespace {

class LawsUnderPotentials {
    using Term = Nonlinear::Term;

public:
    // `potentials`: null without any; then only `on` may be called.
    LawsUnderPotentials(Block& block, ForcesInParts& parts, PotentialSolve* potentials)
        : block_(block), parts_(parts), potentials_(potentials), layout_(block.model.layout), solve_(block.model.solve),
          nl_(block.model.nonlinear), t_(block.model.potentials), ws_(block.space.contacts),
          ts_(block.space.potentials), reach_(block.model.nonlinear.n_contact) {
        for (const Potentials::Part& part : t_.parts)
            if (nl_.k && block.modulated(part.component)) culled_.push_back(part.component);
    }

    bool on() const { return potentials_; }

    // Writes the displacements of a contact port in this sample, now and free of forces, where a potential moves it.
    void displace(const Term& t, double* at) {
        if (!moves(t)) return;
        const ContactSums sums = potentials_->contact(t.component, t.port);
        at[0] = sums.now, at[1] = sums.free, reach(t) = sums.reach;
    }

    // Finds d_j in ts.gap; returns the motion of gap j by the means without nonlinear connections.
    double moved(int j) {
        const std::size_t potentials = t_.two_way.size(), w = wide(int(potentials));
        double *const gap = ts_.gap.data() + j * w, *const meets = ts_.meets.data() + std::size_t(j) * t_.most * w;
        if (!ts_.has_meets[j]) find_meets(j);
        for (std::size_t s = 0; s < w; s += Simd::width) {
            Simd::V sum{};
            for (std::size_t m = s; m < t_.most * w; m += w)
                sum += Simd::load(meets + m) * Simd::load(ts_.reach_lanes.data() + m);
            Simd::store(gap + s, sum);
        }
        for (const Term& term : nl_.terms[j])
            if (moves(term)) gap[potentials_->potential_of(term.component)] += term.factor * reach(term);
        return dot(gap, ts_.alone.data(), int(potentials));
    }

    // Gaps of the active laws per force, the potentials answering, in ts.z.
    const double* yield() {
        const std::size_t w = wide(potentials_->count()), k = nl_.k, n = ws_.active.size(), laws = wide(int(n));
        double* const solved = ts_.solved.data();  // (potentials, laws)
        for (int s = 0; s < potentials_->count(); ++s) {
            std::fill_n(solved + s * laws, laws, 0.0);
            for (std::size_t a = 0; a < n; ++a) solved[s * laws + a] = ts_.gap[ws_.active[a] * w + s];
        }
        potentials_->solve(solved, laws);
        for (const std::size_t i : ws_.active) {
            double* const row = ts_.row.data();
            std::fill_n(row, laws, 0.0);
            add_product(solved, int(laws), ts_.gap.data() + i * w, potentials_->count(), row);
            for (std::size_t a = 0; a < n; ++a)
                ts_.z[i * k + ws_.active[a]] = ws_.z[i * k + ws_.active[a]] - 0.5 * row[a];
        }
        return ts_.z.data();
    }

    // Part of the gap of connection i per force of active law number a that this takes off.
    double yielded(int i, std::size_t a) const {
        const std::size_t w = wide(potentials_->count()), laws = wide(int(ws_.active.size()));
        double sum = 0.0;
        for (int s = 0; s < potentials_->count(); ++s) sum += ts_.gap[i * w + s] * ts_.solved[s * laws + a];
        return 0.5 * sum;
    }

    // The means under the forces of the active laws in sample b; adds their answer to the linear connections' forces f.
    void add_means(int b, double* f) {
        const std::size_t n = ws_.active.size(), laws = wide(int(n));
        for (int s = 0; s < potentials_->count(); ++s) {
            double sum = 0.0;
            for (std::size_t a = 0; a < n; ++a) sum += ts_.solved[s * laws + a] * ws_.law_force[ws_.active[a]];
            ts_.mean[s] = ts_.alone[s] + 0.5 * sum;
        }
        potentials_->add_to_linear(f);
        bound_excursions(b);
    }

    // Bounds on what potentials move the rows of components by whose contacts are culled, in sample b.
    void bound_excursions(int b) {
        for (const int i : culled_)
            ws_.tension_excursion[std::size_t(i) * kBlock + b] = potentials_->excursion(i);
    }

private:
    bool moves(const Term& t) const { return t.contact && block_.modulated(t.component); }
    double& reach(const Term& t) { return reach_[std::size_t(nl_.first[t.component] + t.port)]; }

    // Displacement of gap j per displacement of each fixed port of the potentials, the linear connections answering.
    void find_meets(int j) {
        double* const meets = ts_.meets.data() + std::size_t(j) * t_.most * t_.lanes;
        const double* const from_linear = nl_.from_linear.data() + std::size_t(j) * solve_.m;
        if (parts_.on()) {
            parts_.answer(from_linear, ts_.linear.data());
            for (const Potentials::Port& port : t_.ports) {
                double& meet = meets[port.lane] = 0.0;
                for (const Share& s : port.shares) meet -= s.factor * ts_.linear[s.connection];
            }
        } else {
            for (std::size_t p = 0; p < t_.ports.size(); ++p)
                meets[t_.ports[p].lane] = dot(from_linear, t_.onto_linear.data() + p * layout_.f_width, solve_.m);
        }
        for (const Term& term : nl_.terms[j])
            for (const Potentials::Part& part : t_.parts)
                if (!term.contact && part.component == term.component)
                    meets[t_.ports[part.first_port + term.port].lane] += term.factor;
        ts_.has_meets[j] = 1;
    }

    Block& block_;
    ForcesInParts& parts_;
    PotentialSolve* const potentials_;
    const Layout& layout_;
    const Solve& solve_;
    const Nonlinear& nl_;
    const Potentials& t_;
    ContactState& ws_;
    PotentialState& ts_;
    Array<double> reach_;      // by contact port: displacement per psi_m
    std::vector<int> culled_;  // components whose contact ports a potential moves
};

}  // namespace
}  // namespace tonewood
