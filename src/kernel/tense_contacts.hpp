// Strings whose tension rises and nonlinear connections in one system, sample by sample.
//
// For given tensions the step is that of nonlinear.hpp with other compliances: those of stretched strings come out of a
// pass over their modes, only at the ports of contacts that touch. Newton's method on the tensions goes around the one
// on the forces. A contact that does not touch under the forces found is left out, and the solution without it is then
// the solution: the whole step is one monotone problem. Where no contact touches, nothing differs from tension.hpp.
#pragma once

#include <algorithm>
#include <cmath>

#include "nonlinear.hpp"
#include "tension.hpp"

namespace tonewood {
namespace {

constexpr double kLawTolerance = 3e-12;  // of the largest force

class TenseContacts {
    using Term = Nonlinear::Term;

public:
    TenseContacts(const std::vector<Component>& components, const Layout& layout, const Solve& solve,
                  const Nonlinear& nonlinear, const Tensions& tensions, Workspace& workspace, TensionSpace& space,
                  Statistics& statistics, NonlinearStep& laws, TensionStep& stretched)
        : components_(components), layout_(layout), m_(solve.m), nl_(nonlinear), tensions_(tensions), ws_(workspace),
          ts_(space), statistics_(statistics), laws_(laws), stretched_(stretched) {
        for (const int p : ts_.ports.real)
            if (ts_.ports.ports[p].line < layout_.single_width) alone_.push_back({ts_.ports.ports[p].line, p});
    }

    // As TensionStep::step; `lines` and the guarded values hold the motion of the other components.
    bool step(int b, double* lines, double* f, double* now) {
        stretched_.begin_sample(b, lines);
        laws_.open_sample(b);
        std::fill(is_ready_.begin(), is_ready_.end(), 0);
        // where nothing acted, nothing is expected to: the step without laws is found first, and as a rule it clears all
        bool made = ws_.previous.empty() && !ws_.any_alive && laws_.plain_, clear = false;
        if (made) {
            if (!stretched_.linear_step(f, now)) return false;
            laws_.let_go(b);
            clear = all_clear(b, now);
        }
        if (!clear) laws_.meet_awake(b);
        for (;; made = false) {
            bool told = true;  // where the strings' ports come to, by ports.alone
            if (made && ws_.active.empty()) {
            } else if (ws_.active.empty()) {
                if (!stretched_.linear_step(f, now)) return false;
                laws_.let_go(b);
            } else if (!on_fixed_ports() || !fixed_step(b, f, now)) {
                if (!joint_step(b, lines, f, now)) return false;
                told = false;
            }
            std::fill(is_moved_.begin(), is_moved_.end(), 0);
            if (laws_.calm_.any()) tell_ports(b, lines, now, told);
            if (ws_.active.empty() && laws_.rests(b, now)) {
                stretched_.finish_sample(now);
                return true;
            }
            note_pulls(b);
            const std::size_t n_awake = ws_.awake_list.size();
            laws_.wake_by(b);
            if (clear && n_awake == ws_.awake_list.size()) break;
            if (clear) laws_.meet_awake(b);
            clear = false;
            if (!touched(b, now)) break;
        }
        laws_.commit(b);
        if (laws_.loads_)
            for (const int i : tensions_.components) push(i, b);
        stretched_.finish_sample(now);
        if (laws_.loads_)
            for (const int i : tensions_.components) stretched_.pushed_[i].clear();
        return true;
    }

private:
    // Whether all that is awake touches nothing in the step found without laws, so that its rows need not be read exactly.
    bool all_clear(int b, const double* now) {
        std::fill(is_moved_.begin(), is_moved_.end(), 0);
        for (const int j : ws_.awake_list)
            if (!laws_.clears(j, b, now, [&](const Term& t, double& old, double& after, double& error) {
                    glance(t, b, now, old, after, error);
                }))
                return false;
        return true;
    }

    // A guarded port before and after the step, less its factor, as the last visit to the modes tells: s of the tension
    // visited stands for that of the tension found.
    void glance(const Term& t, int b, const double* now, double& old, double& after, double& error) {
        using S = Simd;
        using V = S::V;
        const int i = t.component;
        const Component& c = components_[i];
        const std::size_t n = c.n;
        const int string = ts_.ports.string_of[i];
        double *const before = stretched_.buffer(ts_.y, i), *const then = stretched_.buffer(ts_.moved, i);
        if (!is_moved_[i]) {
            is_moved_[i] = 1;
            const std::size_t step = std::size_t(kTautNumbers + c.n_ports) * kPadding;
            const double* state = stretched_.taut_.state(i);
            const double* numbers = c.stretched.taut.data() + kTautNumbers * kPadding;
            const double *const in = c.stretched.doors.data(), *const root = in + 3 * n;
            for (std::size_t k = 0; k < n; k += kPadding, state += kTautState * kPadding, numbers += step)
                for (int q = 0; q < kPadding; q += S::width) {
                    const V xi = S::load(state + q), out = S::load(root + k + q);
                    V both = xi + xi + S::load(state + kPadding + q);
                    for (const Input& input : stretched_.known_[i])
                        both += S::load(in + k + q) * S::load(input.vector + k + q) * input.values[b * input.stride];
                    for (int p = 0; p < c.n_ports; ++p)
                        both += S::load(numbers + p * kPadding + q) * now[layout_.port[i] + p];
                    S::store(before + k + q, out * xi);
                    S::store(then + k + q, out * (both * S::load(state + 2 * kPadding + q) - xi));
                }
        }
        const double* const row = c.guarded.rows.data() + (2 * std::size_t(t.port) * n);
        V first{}, second{}, sizes{};
        for (std::size_t k = 0; k < n; k += S::width) {
            const V r = S::load(row + k), a = r * S::load(before + k), z = r * S::load(then + k);
            first += a, second += z;
            sizes += (a < 0.0 ? -a : a) + (z < 0.0 ? -z : z);
        }
        const double change = std::abs(ts_.used[string] - ts_.at[string]) * c.stretched.most_half;
        old -= t.factor * S::sum(first), after -= t.factor * S::sum(second);
        error += std::abs(t.factor) * S::sum(sizes) * (2 * change + kMargin);
    }

    // Where fixed ports of the strings come to, for energies.
    void tell_ports(int b, const double* lines, const double* now, bool told) {
        const double* const line = lines + std::size_t(b) * layout_.width;
        for (const auto& [lane, p] : alone_) {
            const auto& port = ts_.ports.ports[p];
            laws_.calm_.comes_to(lane, told ? line[lane] + ts_.ports.alone[p]
                                            : after({0, port.component, port.port, false, 1.0}, b, now) -
                                                  layout_.single_history[lane] * now[lane]);
        }
    }

    // Whether nothing acts that would make a sum over modes necessary: a contact on a string, or friction, whose forces
    // may fall where motion grows.
    bool on_fixed_ports() const {
        for (const int j : ws_.active) {
            if (nl_.laws[j].kind == Law::friction) return false;
            for (const Term& t : nl_.terms[j])
                if (t.guarded && components_[t.component].stretched.on) return false;
        }
        return true;
    }

    // Tensions and all forces where laws act on fixed ports of strings: the compliances of the laws are those at rest,
    // and what the tensions change is in the displacements that the ports come to by themselves.
    bool fixed_step(int b, double* f, double* now) {
        TensePorts& ports = ts_.ports;
        const int n = int(ports.ports.size());
        const double* linear = stretched_.linear_part();
        for (const int j : ws_.active) {
            const double free = dot(nl_.from_linear.data() + std::size_t(j) * m_, linear, m_);
            ports.law_free[j] = ws_.rest_p[j] - free;
            ws_.size[j] = std::max(ws_.size[j], std::abs(free));
        }
        gather_active();
        const int a = int(ws_.active.size()), w = int(wide(a));
        int iterations = 0;
        const bool foldable = all_linear();
        const bool done = foldable ? folded(iterations) : stretched_.find(kLawTolerance, [&](double* force) {
            for (int p = 0; p < n; ++p) ports.sum[p] = ports.alone[p] + ports.moved[p];
            std::fill_n(ports.active_free.data(), w, 0.0);
            add_product(ports.active_meets.data(), w, ports.sum.data(), n, ports.active_free.data());
            for (int i = 0; i < a; ++i)
                ws_.free_p[ws_.active[i]] = ports.law_free[ws_.active[i]] - ports.active_free[i];
            if (!find_forces(nl_, ws_, ws_.z.data(), iterations)) return false;
            for (int i = 0; i < a; ++i) ports.active_force[i] = ws_.law_force[ws_.active[i]];
            add_product(ports.onto_ports.data(), ports.width, ports.moved.data(), n, ports.base.data(), force);
            add_product(ports.active_ports.data(), ports.width, ports.active_force.data(), a, force);
            return true;
        });
        if (!done) return false;
        laws_.found(true, iterations);
        stretched_.add_moved();
        stretched_.linear_forces(f);
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

    // Tensions and forces where all laws are linear: with force = slope (free - Z force) + given they do as linear
    // connections do, and port forces answer displacements by another matrix, which is kept until a slope changes.
    bool folded(int& iterations) {
        TensePorts& ports = ts_.ports;
        const int n = int(ports.ports.size()), a = int(ws_.active.size()), w = int(wide(a));
        for (int i = 0; i < a; ++i) {
            const int j = ws_.active[i];
            const Push at_zero = ::tonewood::push(nl_.laws[j], 0.0, ws_.old_p[j], nl_.dt);
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
        stretched_.onto_ = ports.onto_with_laws.data(), stretched_.fixed_ = fixed;
        const bool done = stretched_.find_linear();
        stretched_.onto_ = ports.onto_ports.data(), stretched_.fixed_ = ports.fixed.data();
        for (int p = 0; p < n; ++p) ports.sum[p] = -(ports.alone[p] + ports.moved[p]);
        add_product(ports.caught.data(), w, ports.sum.data(), n, force);
        for (int i = 0; i < a; ++i) ws_.law_force[ws_.active[i]] = force[i];
        ++iterations;
        return done;
    }

    // What the linear laws make of the ports' answers, (I + slope Z)^-1 = I + inverse Z.
    void fold_laws() {
        TensePorts& ports = ts_.ports;
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

    // How law j sees and pushes fixed ports of strings, the linear connections answering.
    void know(int j) {
        TensePorts& ports = ts_.ports;
        const std::size_t n = ports.ports.size(), m = m_;
        double *const meets = ports.meets.data() + std::size_t(j) * ports.width, *const forces = ports.law_forces.data();
        std::fill_n(forces, layout_.force_width, 0.0);
        const auto takes = [&](const Term& t) {
            if (t.guarded) return;
            forces[layout_.port[t.component] + t.port] += t.factor;
            if (components_[t.component].stretched.on) meets[ports.first[t.component] + t.port * ports.strings] += t.factor;
        };
        std::fill_n(meets, ports.width, 0.0);
        for (const Term& t : nl_.terms[j]) takes(t);
        for (const Term& t : nl_.driven[j]) takes(t);
        const double *from_linear = nl_.from_linear.data() + j * m, *answer = ws_.answer.data() + std::size_t(j) * layout_.f_width;
        for (std::size_t t = 0; t < n; ++t) meets[t] += dot(from_linear, ports.onto_linear.data() + t * layout_.f_width, m_);
        for (std::size_t q = 0; q < m; ++q)
            for (int p = 0; p < layout_.force_width; ++p)
                forces[p] -= answer[q] * layout_.push[q * layout_.force_width + p];
        for (const int t : ports.real)
            ports.law_ports[std::size_t(j) * ports.width + t] = forces[ports.ports[t].force];
        ports.known[j] = 1;
    }

    // How the active laws see and push fixed ports of strings, side by side.
    void gather_active() {
        TensePorts& ports = ts_.ports;
        if (ports.active == ws_.active) return;
        ports.active = ws_.active, ports.folded = false;
        const std::size_t n = ports.ports.size(), a = ws_.active.size(), w = wide(int(a)), width = ports.width;
        std::fill_n(ports.active_meets.data(), n * w, 0.0);
        for (std::size_t i = 0; i < a; ++i) {
            const std::size_t j = ws_.active[i];
            if (!ports.known[j]) know(int(j));
            for (std::size_t p = 0; p < n; ++p) ports.active_meets[p * w + i] = ports.meets[j * width + p];
            std::copy_n(ports.law_ports.data() + j * width, width, ports.active_ports.data() + i * width);
        }
    }

    // Tensions and all forces, the active connections given.
    bool joint_step(int b, const double* lines, double* f, double* now) {
        find_ports();
        stretched_.gaps_at_start(lines);
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            ts_.tension[s] = std::max(ts_.at[s], tensions_.strings[s].kappa * ts_.stretch[s]);
            for (const int i : tensions_.strings[s].components) ready(i);
        }
        int iterations = 0;
        const bool done = settle(nl_, ws_, [&] {
            bool found = false;
            for (int turn = 1; !found && turn <= kMaxTensionIterations; ++turn, ++iterations) {
                if (!forces(f)) break;
                laws_.distribute(b, f, now);
                found = stretched_.correct(turn, [&](int i, double& after, double& slope, double& size) {
                    move_stretch(i, b, ts_.tension[ts_.ports.string_of[i]], now + layout_.port[i], after, slope, size);
                });
            }
            return found;
        });
        stretched_.book(iterations, done);
        return done;
    }

    // Guarded ports of stretched strings on which active contacts push, and how all connections see their ports.
    void find_ports() {
        for (const int i : tensions_.components) ts_.active_ports[i].clear(), ts_.wires[i].clear();
        for (const int j : ws_.active)
            for (const Term& t : nl_.terms[j]) {
                if (!t.guarded || !components_[t.component].stretched.on) continue;
                auto& list = ts_.active_ports[t.component];
                const auto at = std::lower_bound(list.begin(), list.end(), t.port);
                if (at == list.end() || *at != t.port) list.insert(at, t.port);
            }
        for (const auto& t : tensions_.terms)
            if (components_[t.component].stretched.on) ts_.wires[t.component].push_back({t.connection, t.port, t.factor});
        for (int a = 0; a < int(ws_.active.size()); ++a)
            for (const Term& t : nl_.terms[ws_.active[a]]) {
                if (!components_[t.component].stretched.on) continue;
                ts_.wires[t.component].push_back({m_ + a, t.guarded ? place(t) : t.port, t.factor});
            }
    }

    // A guarded port among those in use.
    int place(const Term& t) const {
        const auto& list = ts_.active_ports[t.component];
        return components_[t.component].n_ports +
               int(std::lower_bound(list.begin(), list.end(), t.port) - list.begin());
    }

    // Ports in use of component i: fixed ones, then guarded ones.
    const double* phi(int i, int p) const {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        return p < c.n_ports ? c.stretched.phi.data() + p * n
                             : c.stretched.guarded_phi.data() + (ts_.active_ports[i][p - c.n_ports] * n);
    }
    const double* per_force(int i, int p) const {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        return p < c.n_ports ? c.stretched.c.data() + p * n : c.stretched.guarded_c.data() + (ts_.active_ports[i][p - c.n_ports] * n);
    }

    // Compliance between two ports in use without additional tension, p <= q.
    double rest(int i, int p, int q) const {
        const Component& c = components_[i];
        const Guarded& g = c.guarded;
        if (q < c.n_ports) return c.history[std::size_t(q) * c.n_rows + p];
        const std::size_t to = ts_.active_ports[i][q - c.n_ports];
        if (p < c.n_ports) return g.from_fixed[(std::size_t(p) * g.n + to) * kBlock];
        return g.from_guarded[(std::size_t(ts_.active_ports[i][p - c.n_ports]) * g.n + to) * kBlock];
    }

    // Where the ports in use would be without forces, and their compliances, at a tension: ts.free and ts.compliance.
    int port_pass(int i, double tension) {
        using S = Simd;
        using V = S::V;
        const Component& c = components_[i];
        const double* u = stretched_.buffer(ts_.u, i);
        double* const kept = stretched_.buffer(ts_.yields, i);
        const double *const half = c.stretched.half.data(), one = 1;
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

    // Forces of all connections at the tensions tried.
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
                    // counts from the old displacement, which old_p knows
                    ws_.free_p[j] -= to.factor * (ts_.free[to.port] - old(i, to.port));
                }
            }
        for (int i = 0; i < m; ++i) std::copy_n(all + i * w, m, M + std::size_t(i) * m);
        std::fill_n(f, layout_.f_width, 0.0);
        if (!stretched_.solve_linear(M, v, f)) return false;
        for (int s = 0; s < a; ++s) {
            double* x = ts_.called.data() + std::size_t(s) * m;
            for (int q = 0; q < m; ++q) v[q] = all[q * w + m + s];
            if (!stretched_.solve_linear(M, v, x)) return false;
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
        const bool done = find_forces(nl_, ws_, ts_.z.data(), iterations);
        if (!laws_.found(done, iterations)) return false;
        for (int s = 0; s < a; ++s) {
            const double force = ws_.law_force[ws_.active[s]], *x = ts_.called.data() + std::size_t(s) * m;
            for (int q = 0; q < m; ++q) f[q] += x[q] * force;
        }
        return true;
    }

    // Displacement of a port in use before the step.
    double old(int i, int p) const { return product(phi(i, p), stretched_.buffer(ts_.y, i), components_[i].n); }

    static double product(const double* a, const double* b, int n) {
        using S = Simd;
        S::V sum{};
        for (int k = 0; k < n; k += S::width) sum += S::load(a + k) * S::load(b + k);
        return S::sum(sum);
    }

    // Forces of sample b on guarded ports of a stretched string, for its motion.
    void push(int i, int b) {
        auto& list = stretched_.pushed_[i];
        const Component& c = components_[i];
        const std::size_t n = c.n;
        list.clear();
        for (const int p : ws_.loaded[i]) {
            const double force = ws_.force[std::size_t(nl_.first[i] + p) * kBlock + b];
            if (force != 0.0) list.push_back({c.guarded.rows.data() + 2 * p * n, force});
        }
    }

    // Coordinates of component i in this sample.
    void ready(int i) {
        if (!is_ready_[i]) stretched_.coordinates(i);
        is_ready_[i] = 1;
    }

    // Coordinates after the step in ts.moved, under port forces f and those on guarded ports; what the stretch gains.
    void move_stretch(int i, int b, double tension, const double* f, double& after, double& slope, double& size) {
        using S = Simd;
        using V = S::V;
        const Component& c = components_[i];
        const Stretched& s = c.stretched;
        const std::size_t n = c.n;
        const double *u = stretched_.buffer(ts_.u, i), *here = stretched_.buffer(ts_.y, i);
        double* to = stretched_.buffer(ts_.moved, i);
        V gained{}, slopes{}, sizes{};
        for (std::size_t k = 0; k < n; k += S::width) {
            V D = S::load(u + k);
            for (int p = 0; p < c.n_ports; ++p) D += S::load(s.c.data() + p * n + k) * f[p];
            for (const int p : ws_.loaded[i])
                D += S::load(s.guarded_c.data() + p * n + k) * ws_.force[std::size_t(nl_.first[i] + p) * kBlock + b];
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

    // How much the tensions found may have moved guarded rows: T/2 sqrt(sum a (y+ + y)^2) <= T/2 sqrt(2 (S+ + S)), and
    // S+ + S is T / kappa.
    void note_pulls(int b) {
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            const double T_used = ts_.used[s], kappa = tensions_.strings[s].kappa;
            const double pull = T_used > 0.0 ? 0.5 * T_used * std::sqrt(2 * T_used / kappa) * (1 + 1e-4) : 0.0;
            for (const int i : tensions_.strings[s].components) ws_.pull[std::size_t(i) * kBlock + b] = pull;
        }
    }

    // Contacts awake that the motion found brings into touch join the active ones.
    bool touched(int b, const double* now) {
        return laws_.add_touching(ws_.active.size(), [&](int j) {
            double p = ws_.offset_after[j];
            for (const Term& t : nl_.terms[j]) p -= t.factor * after(t, b, now);
            return laws_.series_lives(j) ? p - ws_.series_after[j] : p;
        });
    }

    // Displacement of a port after the step.
    double after(const Term& t, int b, const double* now) {
        const int i = t.component;
        const Component& c = components_[i];
        const Guarded& g = c.guarded;
        const std::size_t n = c.n, port = t.port;
        if (c.stretched.on) {
            if (!is_moved_[i]) {
                double unused[3] = {};
                ready(i);
                move_stretch(i, b, ts_.used[ts_.ports.string_of[i]], now + layout_.port[i], unused[0], unused[1], unused[2]);
                is_moved_[i] = 1;
            }
            return product(t.guarded ? c.stretched.guarded_phi.data() + port * n : c.stretched.phi.data() + port * n,
                           stretched_.buffer(ts_.moved, i), c.n);
        }
        double y = t.guarded ? laws_.value(i, t.port)[b + 1] : laws_.line_of(t)[std::size_t(b + 1) * layout_.width];
        for (std::size_t p = 0; p < std::size_t(c.n_ports); ++p)
            y += now[layout_.port[i] + p] *
                 (t.guarded ? g.from_fixed[(p * g.n + port) * kBlock] : c.history[p * c.n_rows + port]);
        for (const std::size_t p : ws_.loaded[i])
            y += ws_.force[(nl_.first[i] + p) * kBlock + b] *
                 (t.guarded ? g.from_guarded[(p * g.n + port) * kBlock] : g.on_rows[p * kBlock * c.n_rows + port]);
        return y;
    }

    const std::vector<Component>& components_;
    const Layout& layout_;
    const int m_;
    const Nonlinear& nl_;
    const Tensions& tensions_;
    Workspace& ws_;
    TensionSpace& ts_;
    Statistics& statistics_;
    NonlinearStep& laws_;
    TensionStep& stretched_;
    struct Alone {
        int lane, port;
    };
    std::vector<Alone> alone_;  // ports that energies may be followed at: in a line, and among those of strings
    std::vector<char> is_moved_ = std::vector<char>(components_.size()), is_ready_ = is_moved_;
};

}  // namespace
}  // namespace tonewood
