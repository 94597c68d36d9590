// Tensions and all forces of a sample where laws act on contact ports of strings under rising tension.
//
// The compliances at the ports of the active laws are summed over the modes at the tensions tried. Newton's method on the
// tensions encloses that on the forces; the whole step is one monotone problem.
#pragma once

#include "law_forces.hpp"
#include "tension_search.hpp"

namespace tonewood {
namespace {

class JointStep {
    using Term = Nonlinear::Term;

public:
    JointStep(Block& block, LawForces& laws, TensionPasses& passes, TensionSearch& search)
        : block_(block), components_(block.model.components), layout_(block.model.layout), solve_(block.model.solve),
          m_(block.model.solve.m), nl_(block.model.nonlinear), tensions_(block.model.tensions),
          ws_(block.model.contacts), ts_(block.model.tension), laws_(laws), passes_(passes), search_(search),
          is_moved_(components_.size()), is_ready_(components_.size()) {}

    void begin_sample() { std::fill(is_ready_.begin(), is_ready_.end(), 0); }
    // Other port forces than before are found: displacements after the step are no longer valid.
    void invalidate() { std::fill(is_moved_.begin(), is_moved_.end(), 0); }

    // Finds tensions and all forces, the active laws given.
    bool operator()(int b, double* f, double* now) {
        find_ports();
        gaps_at_start(b);
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            ts_.tension[s] = std::max(ts_.at[s], tensions_.strings[s].kappa * ts_.stretch[s]);
            for (const int i : tensions_.strings[s].components) ready(i);
        }
        int iterations = 0;
        const bool done = converge_branches(nl_, ws_, [&] {
            bool found = false;
            for (int k = 1; !found && k <= kMaxTensionIterations; ++k, ++iterations) {
                if (!forces(f)) break;
                laws_.distribute(b, f, now);
                found = correct(k, [&](int i, double& after, double& slope, double& size) {
                    move_stretch(i, b, ts_.tension[ts_.ports.string_of[i]], now + layout_.port[i], after, slope, size);
                });
            }
            return found;
        });
        search_.count(iterations, done);
        return done;
    }

    // Displacement of a port after the step.
    double after(const Term& t, int b, const double* now) {
        const int i = t.component;
        const Component& c = components_[i];
        const ContactPorts& g = c.contact;
        const std::size_t n = c.n, port = t.port;
        if (c.tension.on) {
            if (!is_moved_[i]) {
                double unused[3] = {};
                ready(i);
                move_stretch(i, b, ts_.used[ts_.ports.string_of[i]], now + layout_.port[i], unused[0], unused[1], unused[2]);
                is_moved_[i] = 1;
            }
            return product(t.contact ? c.tension.contact_phi.data() + port * n : c.tension.phi.data() + port * n,
                           passes_.buffer(ts_.moved, i), c.n);
        }
        double y = t.contact ? laws_.rows.value(i, t.port)[b + 1] : laws_.rows.line_of(t)[std::size_t(b + 1) * layout_.width];
        for (std::size_t p = 0; p < std::size_t(c.n_ports); ++p)
            y += now[layout_.port[i] + p] *
                 (t.contact ? g.from_fixed[(p * g.n + port) * kBlock] : c.response[p * c.n_rows + port]);
        for (const std::size_t p : ws_.loaded[i])
            y += laws_.rows.force(i, int(p))[b] *
                 (t.contact ? g.from_contact[(p * g.n + port) * kBlock] : g.on_rows[p * kBlock * c.n_rows + port]);
        return y;
    }

private:
    // Contact ports of strings with active laws, and the shares of all connections in the strings' ports.
    void find_ports() {
        for (const int i : tensions_.components) ts_.active_ports[i].clear(), ts_.wires[i].clear();
        for (const int j : ws_.active)
            for (const Term& t : nl_.terms[j]) {
                if (!t.contact || !components_[t.component].tension.on) continue;
                auto& list = ts_.active_ports[t.component];
                const auto at = std::lower_bound(list.begin(), list.end(), t.port);
                if (at == list.end() || *at != t.port) list.insert(at, t.port);
            }
        for (const auto& t : tensions_.terms)
            if (components_[t.component].tension.on) ts_.wires[t.component].push_back({t.connection, t.port, t.factor});
        for (int a = 0; a < int(ws_.active.size()); ++a)
            for (const Term& t : nl_.terms[ws_.active[a]]) {
                if (!components_[t.component].tension.on) continue;
                ts_.wires[t.component].push_back({m_ + a, t.contact ? place(t) : t.port, t.factor});
            }
    }

    // A contact port's place among the ports in use.
    int place(const Term& t) const {
        const auto& list = ts_.active_ports[t.component];
        return components_[t.component].n_ports +
               int(std::lower_bound(list.begin(), list.end(), t.port) - list.begin());
    }

    // Ports in use of component i: fixed ones, then contact ports.
    const double* phi(int i, int p) const {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        return p < c.n_ports ? c.tension.phi.data() + p * n
                             : c.tension.contact_phi.data() + (ts_.active_ports[i][p - c.n_ports] * n);
    }
    const double* per_force(int i, int p) const {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        return p < c.n_ports ? c.tension.c.data() + p * n : c.tension.contact_c.data() + (ts_.active_ports[i][p - c.n_ports] * n);
    }

    // Compliance between two ports in use without additional tension, p <= q.
    double rest(int i, int p, int q) const {
        const Component& c = components_[i];
        const ContactPorts& g = c.contact;
        if (q < c.n_ports) return c.response[std::size_t(q) * c.n_rows + p];
        const std::size_t to = ts_.active_ports[i][q - c.n_ports];
        if (p < c.n_ports) return g.from_fixed[(std::size_t(p) * g.n + to) * kBlock];
        return g.from_contact[(std::size_t(ts_.active_ports[i][p - c.n_ports]) * g.n + to) * kBlock];
    }

    // Sums displacements without forces and compliances of the ports in use at a tension: ts.free and ts.compliance.
    int port_pass(int i, double tension) {
        using S = Simd;
        using V = S::V;
        const Component& c = components_[i];
        const double* u = passes_.buffer(ts_.u, i);
        double* const kept = passes_.buffer(ts_.compliances, i);
        const double *const half = c.tension.half.data(), one = 1;
        for (int k = 0; k < c.n; k += S::width) S::store(kept + k, one / (one + S::load(half + k) * tension));
        const int count = c.n_ports + int(ts_.active_ports[i].size());
        for (int p = 0; p < count; ++p) {
            const double* at = phi(i, p);
            V sum{};
            for (int k = 0; k < c.n; k += S::width) sum += S::load(at + k) * S::load(u + k) * S::load(kept + k);
            ts_.free[p] = S::sum(sum);
            for (int q = p; q < count; ++q) {
                const double* from = per_force(i, q);
                V moved{};
                for (int k = 0; k < c.n; k += S::width) moved += S::load(at + k) * S::load(from + k) * S::load(kept + k);
                ts_.compliance[std::size_t(p) * count + q] = ts_.compliance[std::size_t(q) * count + p] = S::sum(moved);
            }
        }
        return count;
    }

    // Finds the forces of all connections at the tensions tried.
    bool forces(double* f) {
        const int m = m_, a = int(ws_.active.size()), k = nl_.k;
        const std::size_t w = m + a;
        double *all = ts_.all.data(), *v = ts_.right.data(), *M = ts_.matrix.data();
        for (int i = 0; i < m; ++i) std::copy_n(tensions_.matrix.data() + std::size_t(i) * m, m, all + i * w);
        for (int s = 0; s < a; ++s) {
            const std::size_t j = ws_.active[s];
            for (int q = 0; q < m; ++q)
                all[(m + s) * w + q] = all[q * w + m + s] = nl_.from_linear[j * m + q];
            for (int t = 0; t < a; ++t)
                all[(m + s) * w + m + t] = nl_.compliance[j * k + std::size_t(ws_.active[t])];
        }
        std::copy(ts_.fixed.begin(), ts_.fixed.end(), v);
        for (const int j : ws_.active) ws_.free_p[j] = ws_.rest_p[j];
        for (int s = 0; s < int(tensions_.strings.size()); ++s)
            for (const int i : tensions_.strings[s].components) {
                const int count = port_pass(i, ts_.tension[s]);
                for (const auto& to : ts_.wires[i]) {
                    if (to.index < m) v[to.index] += to.factor * ts_.free[to.port];
                    for (const auto& from : ts_.wires[i]) {
                        const int p = std::min(to.port, from.port), q = std::max(to.port, from.port);
                        all[to.index * w + from.index] += to.factor * from.factor *
                            (ts_.compliance[std::size_t(p) * count + q] - rest(i, p, q));
                    }
                }
                for (const auto& to : ts_.wires[i]) {
                    if (to.index < m) continue;
                    const int j = ws_.active[to.index - m];
                    // counts from the old displacement, which old_p includes
                    ws_.free_p[j] -= to.factor * (ts_.free[to.port] - old(i, to.port));
                }
            }
        for (int i = 0; i < m; ++i) std::copy_n(all + i * w, m, M + std::size_t(i) * m);
        std::fill_n(f, layout_.f_width, 0.0);
        if (!solve_linear(M, v, f)) return false;
        for (int s = 0; s < a; ++s) {
            double* x = ts_.called.data() + std::size_t(s) * m;
            for (int q = 0; q < m; ++q) v[q] = all[q * w + m + s];
            if (!solve_linear(M, v, x)) return false;
        }
        for (int s = 0; s < a; ++s) {
            const int j = ws_.active[s];
            const double* row = all + (m + s) * w;
            for (int q = 0; q < m; ++q) ws_.free_p[j] -= row[q] * f[q];
            ws_.size[j] = std::max(ws_.size[j], std::abs(ws_.offset_after[j] - ws_.free_p[j]));
            for (int t = 0; t < a; ++t) {
                double z = row[m + t];
                const double* x = ts_.called.data() + std::size_t(t) * m;
                for (int q = 0; q < m; ++q) z += row[q] * x[q];
                ts_.z[std::size_t(j) * k + ws_.active[t]] = z;
            }
        }
        for (int s = 0; s < a; ++s)
            for (int t = 0; t < s; ++t) {
                double &one = ts_.z[std::size_t(ws_.active[s]) * k + ws_.active[t]],
                       &other = ts_.z[std::size_t(ws_.active[t]) * k + ws_.active[s]];
                one = other = 0.5 * (one + other);
            }
        int iterations = 0;
        const bool done = find_forces(nl_, block_.model.shortcuts, ws_, ts_.z.data(), iterations);
        if (!laws_.count(done, iterations)) return false;
        for (int s = 0; s < a; ++s) {
            const double force = ws_.law_force[ws_.active[s]], *x = ts_.called.data() + std::size_t(s) * m;
            for (int q = 0; q < m; ++q) f[q] += x[q] * force;
        }
        return true;
    }

    // Displacement of a port in use before the step.
    double old(int i, int p) const { return product(phi(i, p), passes_.buffer(ts_.y, i), components_[i].n); }

    static double product(const double* a, const double* b, int n) {
        using S = Simd;
        S::V sum{};
        for (int k = 0; k < n; k += S::width) sum += S::load(a + k) * S::load(b + k);
        return S::sum(sum);
    }

    // Finds the coordinates of component i in this sample, once.
    void ready(int i) {
        if (!is_ready_[i]) passes_.coordinates(i);
        is_ready_[i] = 1;
    }

    // Coordinates after the step in ts.moved, under port forces f and those on contact ports; adds the gain of the stretch.
    void move_stretch(int i, int b, double tension, const double* f, double& after, double& slope, double& size) {
        using S = Simd;
        using V = S::V;
        const Component& c = components_[i];
        const TensionModulation& s = c.tension;
        const std::size_t n = c.n;
        const double *u = passes_.buffer(ts_.u, i), *here = passes_.buffer(ts_.y, i);
        double* to = passes_.buffer(ts_.moved, i);
        V gained{}, slopes{}, sizes{};
        for (std::size_t k = 0; k < n; k += S::width) {
            V D = S::load(u + k);
            for (int p = 0; p < c.n_ports; ++p) D += S::load(s.c.data() + p * n + k) * f[p];
            for (const int p : ws_.loaded[i])
                D += S::load(s.contact_c.data() + p * n + k) * laws_.rows.force(i, p)[b];
            const V yield = 1.0 / (1.0 + S::load(s.half.data() + k) * tension), a = S::load(s.a.data() + k), y = S::load(here + k);
            D *= yield;
            S::store(to + k, D - y);
            const V aD = a * D;
            gained += aD * (D - y - y);
            slopes += aD * S::load(s.half.data() + k) * yield * (D - y);
            sizes += aD * D;
        }
        after += S::sum(gained), slope -= 2 * S::sum(slopes), size += S::sum(sizes);
    }

    // Makes Newton's step of every tension; true if all had converged. `gain_of` adds the gain of a component's stretch.
    template <class Gain>
    bool correct(int iteration, const Gain& gain_of) {
        bool found = true;
        for (int s = 0; s < passes_.n_strings(); ++s) {
            const auto& string = tensions_.strings[s];
            double after = ts_.stretch[s], slope = 0.0, size = after;
            for (const int i : string.components) gain_of(i, after, slope, size);
            const double excess = ts_.tension[s] - string.kappa * (after + ts_.stretch[s]);
            ts_.used[s] = ts_.tension[s];
            if (!(std::abs(excess) <= kTensionTolerance * (ts_.tension[s] + 1e-2 * string.kappa * size))) found = false;
            // the slope at constant forces first, then the secant, which includes the answer of the forces
            double steepness = 1 - string.kappa * slope;
            if (iteration > 1) {
                const double secant = (excess - ts_.last_excess[s]) / (ts_.tension[s] - ts_.last_tension[s]);
                if (secant > 0.5 * steepness && secant < 2 * steepness) steepness = secant;
            }
            ts_.last_excess[s] = excess, ts_.last_tension[s] = ts_.tension[s];
            ts_.tension[s] = std::max(string.kappa * ts_.stretch[s], ts_.tension[s] - excess / steepness);
        }
        return found;
    }

    // Part of the gaps that does not depend on the tensions, gamma g - offset.
    void gaps_at_start(int b) {
        std::fill(ts_.fixed.begin(), ts_.fixed.end(), 0.0);
        const double* line = block_.line(b);
        for (const auto& t : tensions_.terms) {
            const double old = line[layout_.row[t.component] + t.port];
            ts_.fixed[t.connection] += solve_.gamma[t.connection] * t.factor * old;
            if (components_[t.component].tension.on)
                ts_.fixed[t.connection] -= t.factor * old;  // their free displacement counts from the old one
            else
                ts_.fixed[t.connection] += t.factor * line[layout_.width + layout_.row[t.component] + t.port];
        }
        for (int j = 0; j < solve_.m; ++j) ts_.fixed[j] -= tensions_.offset[j];
    }

    // f = -M^-1 v, by an inverse of an earlier sample in the block and corrections with M.
    bool solve_linear(const double* M, const double* v, double* f) {
        const int m = solve_.m;
        double *now = ts_.solution.data(), *residual = ts_.residual.data();
        for (int attempt = 0; attempt < 2; ++attempt) {
            const bool fresh = attempt > 0 || !ts_.inverted;
            if (fresh) invert_symmetric(M, m, ts_.inverse.data(), ts_.scale.data(), ts_.done.data());
            ts_.inverted = true;
            std::fill_n(now, m, 0.0);
            for (int correction = 0; correction < 12; ++correction) {
                double change = 0.0, size = 0.0;
                for (int i = 0; i < m; ++i) residual[i] = -v[i] - dot(M + std::size_t(i) * m, now, m);
                for (int i = 0; i < m; ++i) {
                    const double sum = dot(ts_.inverse.data() + std::size_t(i) * m, residual, m);
                    now[i] += sum;
                    change = std::max(change, std::abs(sum) * ts_.scale[i]);
                    size = std::max(size, std::abs(now[i]) * ts_.scale[i]);
                }
                if (change <= kForceTolerance * size) {
                    std::copy_n(now, m, f);
                    return true;
                }
            }
            if (fresh) break;  // else the tensions are too far from those of the inverse
        }
        std::copy_n(now, m, f);
        for (int i = 0; i < m; ++i)
            if (!std::isfinite(f[i])) return false;
        return true;
    }

    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Solve& solve_;
    const int m_;
    const Nonlinear& nl_;
    const Tensions& tensions_;
    ContactState& ws_;
    TensionState& ts_;
    LawForces& laws_;
    TensionPasses& passes_;
    TensionSearch& search_;
    std::vector<char> is_moved_, is_ready_;  // by component: moved after the step, coordinates known in this sample
};

}  // namespace
}  // namespace tonewood
