// Laws whose force is linear in their compressions, solved with the linear connections: no search of their own.
//
// With p the compression, rho the displacement of the residual compliance in series, s and r the slopes of the law with
// the compression after and before the step,
//     f = s p+ + r p,     p = o - g - rho,     p+ = o - g_free - z f + (1 - theta) / theta rho,
// z the gaps per force with the linear connections answering, so that for all such laws at once
//     (z + 1/s) f = (1 + r/s) o - g_free - (r/s) g + ((1 - theta)/theta - r/s) rho.
// g_free, the gap after the step under the linear connections alone, is linear in the displacements of the ports. So
// the forces of these laws are one product of these and of rho (PortForces, with the laws in place of ports), and the
// port forces are those of the linear connections plus those of the laws. This replaces the solve for the laws in
// blocks in which no other law can act and no control changes one of these.
#pragma once

#include "forces.hpp"

namespace tonewood {
namespace {

class LinearLawForces {
public:
    explicit LinearLawForces(Forces& forces)
        : block_(forces.block), layout_(block_.model.layout), nl_(block_.model.nonlinear), ws_(block_.space.contacts),
          to_(block_.space.linear_laws), laws_(forces.laws), cull_(forces.cull), parts_(forces.parts),
          direct_(layout_) {}

    // Decides for a block whether its candidates can be solved so.
    void begin_block() {
        on_ = false;
        const auto& candidates = cull_.candidates();
        if (!block_.model.shortcuts.linear_laws || candidates.empty() || parts_.on() || layout_.own_port.empty())
            return;
        for (const int j : candidates)
            if (!is_linear(nl_.laws[j])) return;
        scale_.assign(candidates.size(), 1.0);
        for (const Control& control : block_.job.controls)
            if (!is_steady(control)) return;
        if (!to_.known || to_.laws != candidates || to_.scale != scale_) derive();
        force_.resize(to_.forces.width), change_.resize(to_.forces.width), rho_.resize(candidates.size());
        on_ = true;
    }

    // Whether none but these laws can act so far in the block.
    bool on() const { return on_ && cull_.candidates().size() == to_.laws.size(); }

    // Finds the forces of these laws in sample b and adds their port forces to those of the linear connections.
    __attribute__((flatten)) void add(int b, double* now) {
        const int n = int(to_.laws.size());
        direct_(to_.forces, block_.line(b), force_.data());
        for (int i = 0; i < n; ++i) rho_[i] = ws_.series[nl_.place[to_.laws[i]]];
        add_product(to_.memory.data(), to_.forces.width, rho_.data(), n, force_.data());
        add_product(to_.loads.data(), layout_.force_width, force_.data(), n, now);
    }

    // Adds the answer of these laws to potentials.
    void answer(PotentialSolve& potentials, double* now) {
        std::fill(change_.begin(), change_.end(), 0.0);
        potentials.add(to_.onto_laws.data(), to_.forces.width, change_.data());
        for (std::size_t i = 0; i < to_.laws.size(); ++i) force_[i] += change_[i];
        add_product(to_.loads.data(), layout_.force_width, change_.data(), int(to_.laws.size()), now);
    }
    // (ports, width): forces on the ports of potentials' components per displacement of one, with these laws.
    const double* onto_ports() const { return to_.onto_ports.data(); }

    // Makes the forces of sample b final, those on all ports in `now`, of the linear connections in `f`; false, with
    // nothing made final, if a contact could touch.
    bool commit(int b, const double* now, double* f) {
        if (!laws_.commit_alone(b, to_.laws, force_.data())) return false;
        own_forces(layout_, now, block_.model.solve.m, f);
        for (const auto& [connection, law, factor] : to_.shared) f[connection] -= factor * force_[law];
        return true;
    }

private:
    // Whether a control keeps its connection, if it is one of these, at the law's offset and at one factor over the
    // block.
    bool is_steady(const Control& control) {
        const auto& candidates = cull_.candidates();
        const auto at = std::lower_bound(candidates.begin(), candidates.end(), control.connection);
        if (at == candidates.end() || *at != control.connection) return true;
        const double *from = control.values + block_.start, *scale = from + 3 * block_.job.n;
        const double offset = nl_.laws[control.connection].offset;
        for (int b = 0; b < block_.nb; ++b)
            if (from[b] != offset || from[block_.job.n + b] != offset || scale[b] != scale[0]) return false;
        scale_[std::size_t(at - candidates.begin())] = scale[0];
        return true;
    }

    void derive() {
        to_.known = true, to_.laws = cull_.candidates(), to_.scale = scale_;
        const std::size_t n = to_.laws.size(), m = block_.model.solve.m, ports = layout_.port_rows.size();
        const std::size_t width = layout_.force_width, f_width = layout_.f_width, w = wide(int(n));
        to_.shared.clear();
        Array<double> gap(n * ports, 0.0);  // share of two-way ports in each gap
        to_.loads.assign(n * width, 0.0);
        for (std::size_t i = 0; i < n; ++i) {
            const int j = to_.laws[i];
            double *const loads = to_.loads.data() + i * width, *const shares = gap.data() + i * ports;
            laws_.need_response(j);
            const double* const answer = ws_.answer.data() + std::size_t(j) * f_width;
            for (std::size_t q = 0; q < m; ++q)
                for (std::size_t p = 0; p < width; ++p) loads[p] -= answer[q] * layout_.scatter[q * width + p];
            for (const auto* terms : {&nl_.terms[j], &nl_.driven[j]})
                for (const Nonlinear::Term& t : *terms) {
                    const int port = layout_.port[t.component] + t.port;
                    loads[port] += t.factor;
                    for (std::size_t q = 0; q < m; ++q)
                        if (layout_.own_port[q] == port)
                            to_.shared.push_back({int(q), int(i), layout_.own_factor[q] * t.factor});
                }
            const auto& rows = layout_.port_rows;
            for (const Nonlinear::Term& t : nl_.terms[j])
                shares[std::find(rows.begin(), rows.end(), layout_.row[t.component] + t.port) - rows.begin()] +=
                    t.factor;
        }
        // -(z + 1/s)^-1 = -sqrt(s) (1 + sqrt(s) z sqrt(s))^-1 sqrt(s)
        Array<double> slope(n), ratio(n), z(n * w, 0.0);
        for (std::size_t i = 0; i < n; ++i) {
            const Law& law = nl_.laws[to_.laws[i]];
            const auto [spring, dashpot] = linear_law(law, nl_.dt);
            slope[i] = (spring + dashpot) * scale_[i];
            ratio[i] = spring + dashpot > 0.0 ? (spring - dashpot) / (spring + dashpot) : 0.0;
            for (std::size_t q = 0; q < n; ++q) z[i * w + q] = mutual(ws_.z.data(), nl_.k, to_.laws[i], to_.laws[q]);
        }
        Array<double> inverse;
        invert_laws(ws_, z.data(), slope.data(), int(n), inverse);
        // right side per displacement of a two-way port after the step without forces, and before it
        const double theta = nl_.theta, kept = (1 - theta) / theta;
        const PortForces& plain = layout_.direct;
        PortForces& out = to_.forces;
        out = {int(w), plain.mix, Array<double>(w, 0.0), Array<double>(ports * w, 0.0), Array<double>(ports * w, 0.0), {}};
        for (std::size_t p = 0; p < ports; ++p) out.rows.push_back(int(p));
        to_.memory.assign(n * w, 0.0);
        // the forces that a right side makes
        const auto solve = [&](const auto& side, double* force) {
            for (std::size_t q = 0; q < n; ++q)
                for (std::size_t i = 0; i < n; ++i) force[q] -= inverse[q * w + i] * side(i);
        };
        const auto linear = [&](std::size_t i, const double* f) {
            return dot(nl_.from_linear.data() + std::size_t(to_.laws[i]) * m, f, int(m));
        };
        for (std::size_t p = 0; p < ports; ++p) {
            const double *before = layout_.gather.data() + p * f_width,
                         *after = layout_.gather.data() + (ports + p) * f_width;
            const auto free = [&](std::size_t i) { return -gap[i * ports + p] - linear(i, after); };
            solve(free, out.free.data() + p * w);
            solve(
                [&](std::size_t i) { return -ratio[i] * gap[i * ports + p] - linear(i, before) - plain.mix * free(i); },
                out.old.data() + p * w);
        }
        solve(
            [&](std::size_t i) {
                return (1 + ratio[i]) * nl_.laws[to_.laws[i]].offset - linear(i, layout_.constant.data());
            },
            out.constant.data());
        for (std::size_t q = 0; q < n; ++q)
            solve([&](std::size_t i) { return i == q ? kept - ratio[i] : 0.0; }, to_.memory.data() + q * w);
        const Potentials& t = block_.model.potentials;
        to_.onto_laws.assign(t.ports.size() * w, 0.0), to_.onto_ports = t.onto_ports;
        for (std::size_t p = 0; p < t.ports.size(); ++p) {
            double* const laws = to_.onto_laws.data() + p * w;
            std::copy_n(out.free.data() + t.ports[p].place * w, w, laws);
            for (std::size_t q = 0; q < t.ports.size(); ++q)
                for (std::size_t i = 0; i < n; ++i)
                    to_.onto_ports[p * t.most * t.lanes + t.ports[q].lane] += laws[i] * to_.loads[i * width + t.ports[q].force];
        }
    }

    Block& block_;
    const Layout& layout_;
    const Nonlinear& nl_;
    ContactState& ws_;
    LinearLaws& to_;
    LawForces& laws_;
    const BroadPhase& cull_;
    const ForcesInParts& parts_;
    DirectForces direct_;
    bool on_ = false;
    Array<double> scale_, rho_, force_, change_;  // factors; displacements of the residual compliances; forces; answers
};

}  // namespace
}  // namespace tonewood
