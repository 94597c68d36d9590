// Strings whose tension rises with amplitude, sample by sample; the equations are in tonewood.coupling.tension.
//
// What other components and connections do is linear in the displacements d_p that a stretched component's ports would
// come to by themselves, less what their compliance at rest gives for their forces:
//     d = sum r (U - x) + (Z(T) - Z(0)) f,      all port forces = fixed part + onto^T d.
// So the forces are a fixed point that shrinks by the relative rise of the tension in each turn; T obeys
// T = kappa (S+ + S). A visit to the modes (tense_ports.hpp) tells both near the tension foreseen: as a rule one visit
// makes the step before and settles this one.
#pragma once

#include <algorithm>
#include <cmath>

#include "lines.hpp"
#include "nonlinear.hpp"
#include "tense_turns.hpp"
#include "tense_ports.hpp"

namespace tonewood {
namespace {

constexpr int kMaxTensionIterations = 200;
// relative changes of a mode's stiffness
constexpr double kCell = 0.01;    // over a cell of compliances
constexpr double kStrong = 0.05;  // beyond which forces are found by an inverse
constexpr double kSoft = 0.01;    // up to which forces and tensions are found side by side

class TensionStep {
    friend class TenseContacts;

public:
    TensionStep(const std::vector<Component>& components, const Layout& layout, const Solve& solve,
                const Tensions& tensions, TensionSpace& space, Statistics& statistics, const Job& job,
                const std::vector<std::vector<Input>>& known, Taut& taut)
        : components_(components), layout_(layout), solve_(solve), tensions_(tensions), ws_(space), ports_(space.ports),
          statistics_(statistics), job_(job), known_(known), at_once_(layout), taut_(taut), pushed_(components.size()),
          forces_(space.ports.ports.size()) {
        std::size_t n_forces = 0;
        for (int s = 0; s < n_strings(); ++s)
            for (const int i : tensions_.strings[s].components) {
                pushed_[i].reserve(components[i].guarded.n);
                part_of_[i] = int(parts_.size());
                parts_.push_back({components.data() + i, known_.data() + i, pushed_.data() + i, taut_.state(i), lanes(ports_.own[i]),
                                  forces_.data() + n_forces, layout_.port[i], i, s});
                n_forces += components[i].n_ports;
            }
    }

    // A block begins; `entered` if it goes on where the one before ended. Else it depends on nothing but the state.
    void begin_block(bool entered) {
        ws_.inverted = false;
        goes_on_ = entered;
        if (entered) return;
        for (Part& part : parts_) taut_.enter(part.slot), part.kept_at = INFINITY;
        for (Array<double>* a : {&ports_.force, &ports_.base}) std::fill(a->begin(), a->end(), 0.0);
        for (int s = 0; s < n_strings(); ++s)
            for (int j = 0; j < 3; ++j) ws_.means[j][s] = job_.tension[3 * tensions_.strings[s].index + j];
    }

    // Sample b of a block: rows of the stretched components, tensions, forces of the linear connections in f, port
    // forces in now. The stretched components move by the next sample, or the end of the block. False if the tensions
    // were not found.
    bool step(int b, double* lines, double* f, double* now) {
        begin_sample(b, lines);
        if (!linear_step(f, now)) return false;
        finish_sample(now);
        return true;
    }

    // The end of a block, rows of the stretched components there and, if it is `asked` for, their state.
    template <class Asked>
    void finish_block(int nb, const Asked& asked, double* lines) {
        for (Part& part : parts_) {
            if (!asked(part.slot) && part.c->n_rows == part.c->n_ports) continue;
            make(part);
            taut_.tell(part.slot);
            rows(part.slot, 0, nb, lines);
        }
        for (int s = 0; s < n_strings(); ++s)
            for (int j = 0; j < 3; ++j) job_.tension[3 * tensions_.strings[s].index + j] = ws_.means[j][s];
    }

private:
    using V = Simd::V;
    static constexpr int kWidth = Simd::width;

    // use.operator()<S>(), S the lanes that strings stand side by side in
    template <class Use>
    auto in_lanes(const Use& use) {
        if (ports_.strings == 1) return use.template operator()<Lanes<1>>();
        if constexpr (kWidth > 2)
            if (ports_.strings == 2) return use.template operator()<Lanes<2>>();
        if constexpr (kWidth > 4)
            if (ports_.strings == 4) return use.template operator()<Lanes<4>>();
        return use.template operator()<Simd>();
    }

    double* lanes(std::size_t sum) const { return ports_.lanes.data() + sum * kWidth; }

    struct Part {  // a stretched component
        const Component* c;
        const std::vector<Input>* known;
        std::vector<Load>* pushed;
        double *state, *sums, *forces;
        int port, slot, string;  // its first port among all forces
        bool pending = false;    // its last step is still to be made
        double kept_at = 0.0;    // tension that its s are of
    };
    int n_strings() const { return int(tensions_.strings.size()); }
    int n_ports() const { return int(ports_.ports.size()); }

    // The stretched components come to sample b; what they are there, and what pulls at them from outside.
    void begin_sample(int b, double* lines) {
        sample_ = b;
        in_lanes([&]<class S>() { foresee<S>(); });
        for (int s = 0; s < n_strings(); ++s) look(s);
        in_lanes([&]<class S>() { fold<S>(); });
        if (!goes_on_)
            for (int s = 0; s < ports_.strings; ++s)
                ws_.past[s] = ws_.means[0][s] * ports_.over_kappa[s] - ws_.stretch[s];
        double* line = lines + std::size_t(b) * layout_.width;
        for (const int p : ports_.real) {
            const auto& port = ports_.ports[p];
            line[port.line] = port_sum(0)[p], line[layout_.width + port.line] = 0.0;
        }
        for (const Part& part : parts_)
            if (part.c->n_rows > part.c->n_ports) taut_.tell(part.slot), rows(part.slot, part.c->n_ports, b, lines);
        at_once_(line, ports_.fixed_part.data());
        for (const int p : ports_.real) ports_.fixed[p] = ports_.fixed_part[ports_.ports[p].force];
        line_ = line;
        linear_known_ = false, goes_on_ = true;
    }

    // The tensions foreseen: S, or the means of T at a block's beginning, going on as a parabola.
    template <class S>
    void foresee() {
        using V = typename S::V;
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V last = of<S>(ws_.means[0], s), kappa = of<S>(ports_.kappa, s), old = of<S>(ws_.stretch, s);
            V foreseen = 3 * (last - of<S>(ws_.means[1], s)) + of<S>(ws_.means[2], s);
            if (goes_on_) {
                const V stretch = last * of<S>(ports_.over_kappa, s) - old;
                const V gone_on = kappa * (stretch + 3 * (stretch - old) + of<S>(ws_.past, s));
                foreseen = kappa > 0.0 ? gone_on : foreseen;
                S::store(ws_.past.data() + s, old);
            }
            S::store(ws_.at.data() + s, foreseen > 0.0 ? foreseen : V{});
        }
    }

    // Forces of the linear connections while the ports do not move by themselves.
    const double* linear_part() {
        if (linear_known_) return ports_.linear.data();
        const int n = int(layout_.port_rows.size());
        for (int p = 0; p < n; ++p) {
            ports_.y[p] = line_[layout_.port_rows[p]];
            ports_.y[n + p] = line_[layout_.width + layout_.port_rows[p]];
        }
        std::copy(layout_.constant.begin(), layout_.constant.end(), ports_.linear.begin());
        add_product(layout_.pull.data(), layout_.f_width, ports_.y.data(), 2 * n, ports_.linear.data());
        linear_known_ = true;
        return ports_.linear.data();
    }

    // Visits a string's modes at the tension ws.at, which may make the step that is due.
    void look(int s) {
        const double at = ws_.at[s];
        Visit v;
        v.tried = at, v.begun = sample_, v.first = true;
        v.shared = lanes(s), v.next_shared = std::size_t(ports_.strings) * kWidth;
        v.next_own = std::size_t(n_ports()) * kWidth, v.next_port = v.next_shared;
        v.made = ws_.used[s];
        for (const int i : tensions_.strings[s].components) {
            Part& part = parts_[part_of_[i]];
            const Component& c = *part.c;
            v.inputs = part.known->data(), v.n_inputs = int(part.known->size());
            v.own = part.sums, v.forces = part.forces;
            if (part.pending && std::abs(v.made - part.kept_at) * c.stretched.most_half < kTold &&
                std::abs(at - v.made) * c.stretched.most_half < kNear) {
                visit<true, true, true>(c, part.state, v);
                taut_.has_moved(i);
                part.pending = false;
            } else {
                make(part);
                bring_near(part, at, kNear);
                if (v.n_inputs)
                    visit<false, true, false>(c, part.state, v);
                else
                    visit<false, true, true>(c, part.state, v);
            }
            part.kept_at = at;
            v.first = false;
        }
    }

    // Makes the step that is due.
    void make(Part& part) {
        if (!part.pending) return;
        Visit v;
        v.made = ws_.used[part.string], v.forces = part.forces;
        bring_near(part, v.made, kTold);
        visit<true, false, true>(*part.c, part.state, v);
        taut_.has_moved(part.slot);
        part.kept_at = v.made, part.pending = false;
    }

    // What is kept of a component's modes must be near the next tension.
    void bring_near(Part& part, double tension, double limit) {
        if (std::abs(tension - part.kept_at) * part.c->stretched.most_half < limit) return;
        taut_.yield(part.slot, tension);
        part.kept_at = tension;
    }

    // Sums of a visit, those of the same kind side by side.
    template <class S>
    void fold() {
        double* to = ports_.sums.data();
        const std::size_t n = kSharedSums * std::size_t(ports_.strings) + kPortSums * ports_.ports.size();
        for (std::size_t k = 0; k < n; k += kWidth) Simd::store(to + k, sums<kWidth>(lanes(k)));
        for (int s = 0; s < ports_.strings * kSharedSums; s += S::width) S::store(to + s, 2.0 * S::load(to + s));
        std::copy_n(shared_sum(0), ports_.strings, ws_.stretch.begin());
    }

    // Tensions and forces where only linear connections act.
    bool linear_step(double* f, double* now) {
        const bool done = find_linear();
        statistics_.failures += !done;
        add_moved();
        add_product(ports_.onto_forces.data(), layout_.force_width, ports_.alone.data(), n_ports(),
                    ports_.fixed_part.data(), now);
        if (layout_.own_port.empty()) {
            linear_forces(f);
        } else {
            if (layout_.own_in_order)
                for (int j = 0; j < solve_.m; ++j) f[j] = layout_.own_factor[j] * now[j];
            else
                for (int j = 0; j < solve_.m; ++j) f[j] = layout_.own_factor[j] * now[layout_.own_port[j]];
        }
        return done;
    }

    // ports.alone becomes all of what ports move by.
    void add_moved() {
        for (int p = 0; p < n_ports(); ++p) ports_.alone[p] += ports_.moved[p];
    }

    // Forces of the linear connections, after that.
    void linear_forces(double* f) {
        add_product(ports_.onto_linear.data(), layout_.f_width, ports_.alone.data(), n_ports(), linear_part(), f);
    }

    // Tensions, and the forces on the ports: `turns` goes nearer to both until that changes nothing, or until it has
    // `failed`; true if it got there. A string whose tension went too far from where its modes were visited is visited
    // again.
    template <class S, class Turns>
    bool search(const Turns& turns) {
        int iterations = 0;
        bool done = false, failed = false;
        while (!done && !failed && iterations++ < kMaxTensionIterations) {
            if (iterations == 1) {
                std::copy(ws_.at.begin(), ws_.at.end(), ws_.tension.begin());
                std::fill(ws_.last_tension.begin(), ws_.last_tension.end(), NAN);
            } else {
                for (int s = 0; s < n_strings(); ++s)
                    if (ws_.far[s] != 0.0) ws_.at[s] = ws_.tension[s], look(s);
                fold<S>();
            }
            if (is_beyond<S>()) continue;
            if (!expand<S>()) break;
            const bool told = turns(failed);
            const bool close = all_close<S>();
            done = told && close, failed = failed || (close && !told);
        }
        std::copy(ws_.tension.begin(), ws_.tension.end(), ws_.used.begin());
        return book(iterations, done);
    }

    // Whether a tension must be higher, by what its string is stretched already, than the visit to its modes can tell:
    // ws.far marks such strings.
    template <class S>
    bool is_beyond() {
        using V = typename S::V;
        V beyond{};
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V at = of<S>(ws_.at, s), least_tension = of<S>(ports_.kappa, s) * of<S>(ws_.stretch, s);
            const V mark = least_tension > at + kFar * (at + of<S>(ports_.over_most, s)) ? V{} + 1.0 : V{};
            S::store(ws_.far.data() + s, mark), S::store(ws_.tension.data() + s, most(of<S>(ws_.tension, s), least_tension));
            beyond += mark;
        }
        return S::sum(beyond) != 0.0;
    }

    // Where port forces are onto^T d and a fixed part. As a rule a product brings the forces three digits nearer, a Newton
    // step the tensions as near as the forces allow: two products for each turn. Where stiffness rises much, the forces
    // are settled first, so that a secant tells of nothing but tensions.
    bool find_linear() {
        return in_lanes([&]<class S>() { return find_linear<S>(); });
    }
    template <class S>
    bool find_linear() {
        using V = typename S::V;
        const int width = ports_.width, n = n_ports();
        double *const force = ports_.force.data(), *const next = ports_.next.data(), *const all = ports_.wrong.data();
        const auto answer = [&](double* to) {
            move_ports<S>(force);
            for (int p = 0; p < n; p += S::width) S::store(all + p, of<S>(ports_.alone, p) + of<S>(ports_.moved, p));
            add_product(onto_, width, all, n, fixed_, to);
        };
        const auto turn = [&](bool soft) {
            displacements<S>();
            if (strong_) invert_ports<S>();
            else answer(force);
            for (int product = 0; !strong_ && !soft && product < kMaxTurns; ++product) {
                std::copy_n(force, n, next);
                answer(force);
                double change = 0.0, size = 0.0;
                for (int p = 0; p < n; ++p) {
                    change = std::max(change, std::abs(force[p] - next[p]));
                    size = std::max(size, std::abs(force[p]));
                }
                if (change * largest_ <= kForceTolerance * size) break;
            }
            answer(next);
            V sizes{}, unsettled{};
            // they are differences, of the fixed part and what displacements call up: rounded as these are
            for (int p = 0; p < n; p += S::width)
                sizes = most(sizes, most(size(S::load(next + p)), size(S::load(fixed_ + p))));
            const double enough = kForceTolerance * (strong_ ? 4 : 1) * S::largest(sizes);
            const double shrinks = strong_ ? 1.0 : std::min(1.0, kForceLeft * largest_);
            for (int p = 0; p < n; p += S::width) {
                const V now = S::load(next + p), wrong = now - S::load(force + p);
                unsettled += shrinks * size(wrong) <= enough ? V{} : V{} + 1.0;
                S::store(all + p, wrong);
                if (!strong_) S::store(force + p, now);
            }
            if (strong_) add_product(ports_.inverse.data(), width, all, n, force);
            return S::sum(unsettled + raise_tensions<S>(!soft)) == 0.0;
        };
        return search<S>([&](bool&) {
            const bool soft = largest_ <= kSoft;
            bool told = false;
            if (soft && soft_turns<S>(told)) return told;
            for (int k = 0; !told && k < kMaxTurns; ++k) told = turn(soft);
            move_ports<S>(force);
            return told;
        });
    }

    // Where stiffness rises little, in registers, if strings have the usual shape; else false.
    template <class S>
    bool soft_turns(bool& told) {
        if (ports_.strings != S::width || ports_.most_components != 2) return false;
        if (ports_.most_ports != 1 && ports_.most_ports != 2) return false;
        told = ports_.most_ports == 1 ? SoftTurns<S, 2, 1>(ports_, ws_, onto_, fixed_)(largest_)
                                      : SoftTurns<S, 2, 2>(ports_, ws_, onto_, fixed_)(largest_);
        return true;
    }

    // Where laws answer too: `answer` tells the forces from the displacements ports.alone and ports.moved.
    template <class Answer>
    bool find(double tolerance, const Answer& answer) {
        return in_lanes([&]<class S>() {
            return search<S>([&](bool& failed) {
                bool told = false;
                for (int turn = 0; !told && !failed && turn < kMaxTurns; ++turn) {
                    displacements<S>();
                    add_product(onto_, ports_.width, ports_.alone.data(), n_ports(), fixed_, ports_.base.data());
                    bool settled = false;
                    failed = strong_ || !settle<S>(turn == 0 ? 3 : kMaxTurns, tolerance, answer, settled);
                    told = !failed && S::sum(raise_tensions<S>(true)) == 0.0 && settled;
                }
                return told;
            });
        });
    }

    bool book(int iterations, bool done) {
        statistics_.tension_iterations += iterations;
        statistics_.most_tension_iterations = std::max<std::int64_t>(statistics_.most_tension_iterations, iterations);
        return done;
    }

    // Compliances, less what they are at rest, and two derivatives at the tensions that modes were visited at. False if
    // one of these is no number.
    template <class S>
    bool expand() {
        using V = typename S::V;
        V highest{}, outside{};
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V at = of<S>(ws_.at, s);
            highest = most(highest, at * of<S>(ports_.most, s));
            const V not_below = at >= of<S>(ports_.low, s) ? V{} : V{} + 1.0;
            outside += at < of<S>(ports_.high, s) ? not_below : V{} + 1.0;
        }
        if (S::sum(outside) != 0.0)
            for (int s = 0; s < n_strings(); ++s) {
                if (!std::isfinite(ws_.at[s])) return false;
                enter_cell(s);
            }
        largest_ = S::largest(highest);
        strong_ = largest_ > kStrong;
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V by = of<S>(ws_.at, s) - of<S>(ports_.low, s);
            for (int q = s; q < ports_.pair_width; q += ports_.strings) {
                V value{}, rise{}, bend{};
                for (int j = kTaylor - 1; j >= 0; --j) {
                    bend = bend * by + rise;
                    rise = rise * by + value;
                    value = value * by + S::load(ports_.changes.data() + (std::size_t(j) * ports_.pair_width + q));
                }
                S::store(ports_.change_at.data() + q, value), S::store(ports_.slope_at.data() + q, rise);
                S::store(ports_.bend_at.data() + q, bend);
            }
        }
        return true;
    }

    // Where the ports come to by themselves at the tensions tried, and how their compliances differ from those at rest.
    template <class S>
    void displacements() {
        using V = typename S::V;
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V by = of<S>(ws_.tension, s) - of<S>(ws_.at, s);
            for (int p = s; p < n_ports(); p += ports_.strings)
                S::store(ports_.alone.data() + p, port_sum<S>(1, p) - by * (port_sum<S>(2, p) - by * port_sum<S>(4, p)));
            for (int q = s; q < ports_.pair_width; q += ports_.strings) {
                const V slope = of<S>(ports_.slope_at, q), bend = by * of<S>(ports_.bend_at, q);
                S::store(ports_.change.data() + q, of<S>(ports_.change_at, q) + by * (slope + bend));
                S::store(ports_.slope.data() + q, slope + 2.0 * bend);
            }
        }
    }

    // Compliances about the tension of a string, made anew where it leaves their cell.
    void enter_cell(int s) {
        const double tension = ws_.at[s], most = ports_.most[s];
        if (tension >= ports_.low[s] && tension < ports_.high[s]) return;
        const auto begin = [&](int index) { return std::expm1(kCell * index) / most; };
        int index = int(std::log1p(most * tension) / kCell);
        while (index > 0 && tension < begin(index)) --index;
        while (tension >= begin(index + 1)) ++index;
        ports_.low[s] = begin(index), ports_.high[s] = begin(index + 1);
        const auto& components = tensions_.strings[s].components;
        for (const auto& pair : ports_.pairs) {
            if (pair.component >= int(components.size())) continue;
            const Component& c = components_[components[pair.component]];
            if (pair.from >= c.n_ports) continue;
            double terms[kTaylor];
            compliances(c, ports_.low[s], pair.to, pair.from, terms);
            for (int j = 0; j < kTaylor; ++j)
                ports_.changes[std::size_t(j) * ports_.pair_width + pair.pair + s] = terms[j];
        }
    }

    // ports.moved = (Z(T) - Z(0)) f
    template <class S>
    void move_ports(const double* force) {
        using V = typename S::V;
        double *const moved = ports_.moved.data(), *const change = ports_.change.data();
        for (const auto& [component, to, from, pair, to_port, from_port] : ports_.pairs)
            for (int s = 0; s < ports_.strings; s += S::width) {
                double *const one = moved + to_port + s, *const other = moved + from_port + s;
                const V z = S::load(change + pair + s), by_one = z * S::load(force + from_port + s);
                if (to == from) {
                    S::store(one, by_one);
                } else {
                    S::store(one, S::load(one) + by_one);
                    S::store(other, S::load(other) + z * S::load(force + to_port + s));
                }
            }
    }

    // The forces that the displacements call up and that make the displacements, at the tensions tried. Each turn shrinks
    // what is wrong by about the largest rise of a mode's stiffness; `settled` once that is below `tolerance`.
    template <class S, class Answer>
    bool settle(int turns, double tolerance, const Answer& answer, bool& settled) {
        using V = typename S::V;
        double *const force = ports_.force.data(), *const next = ports_.next.data();
        const double shrinks = std::min(1.0, 2 * largest_);
        for (int turn = 0; !settled && turn < turns; ++turn) {
            move_ports<S>(force);
            if (!answer(next)) return false;
            V changes{}, sizes{}, check{};
            for (int p = 0; p < n_ports(); p += S::width) {
                const V now = S::load(next + p), change = size(now - S::load(force + p));
                changes = most(changes, change), sizes = most(sizes, size(now)), check += change;
                S::store(force + p, now);
            }
            if (!(S::sum(check) <= 1e300)) return false;
            settled = S::largest(changes) * shrinks <= tolerance * S::largest(sizes);
        }
        move_ports<S>(force);
        return true;
    }

    // ports.inverse^T = (I - onto^T (Z(T) - Z(0)))^-1 by Gauss and Jordan: its diagonal dominates as that of 1 + a T w / 2.
    template <class S>
    void invert_ports() {
        const int n = n_ports(), w = ports_.width;
        double *const a = ports_.inverse.data(), *const unit = ports_.wrong.data();
        for (int p = 0; p < n; ++p) {
            for (int q = 0; q < n; ++q) unit[q] = q == p ? 1.0 : 0.0;
            move_ports<S>(unit);
            for (int to = 0; to < n; ++to) {
                double sum = to == p ? 1.0 : 0.0;
                for (int q = 0; q < n; ++q)
                    sum -= onto_[std::size_t(q) * ports_.width + to] * ports_.moved[q];
                a[std::size_t(p) * w + to] = sum;
            }
        }
        int* const pivots = ports_.pivots.data();
        for (int p = 0; p < n; ++p) {
            int best = p;
            for (int i = p + 1; i < n; ++i)
                if (std::abs(a[i * w + p]) > std::abs(a[best * w + p])) best = i;
            pivots[p] = best;
            for (int j = 0; j < n; ++j) std::swap(a[p * w + j], a[best * w + j]);
            const double pivot = a[p * w + p];
            a[p * w + p] = 1.0;
            for (int j = 0; j < n; ++j) a[p * w + j] /= pivot;
            for (int i = 0; i < n; ++i) {
                if (i == p) continue;
                const double ratio = a[i * w + p];
                a[i * w + p] = 0.0;
                for (int j = 0; j < n; ++j) a[i * w + j] -= ratio * a[p * w + j];
            }
        }
        for (int p = n - 1; p >= 0; --p)
            for (int i = 0; i < n; ++i) std::swap(a[i * w + p], a[i * w + pivots[p]]);
    }

    template <class S>
    static auto of(const Array<double>& a, int p) { return S::load(a.data() + p); }
    const double* shared_sum(int kind) const { return ports_.sums.data() + std::size_t(kind) * ports_.strings; }
    const double* port_sum(int kind) const {
        return ports_.sums.data() + (std::size_t(kSharedSums) * ports_.strings + std::size_t(kind) * ports_.ports.size());
    }
    template <class S>
    auto shared_sums(int kind, int s) const { return S::load(shared_sum(kind) + s); }
    template <class S>
    auto port_sum(int kind, int p) const { return S::load(port_sum(kind) + p); }

    // Newton's step of every tension, at the forces found; the sum of what is returned counts those that changed.
    template <class S>
    auto raise_tensions(bool by_secant) {
        using V = typename S::V;
        V changed{};
        const double* const third = ports_.changes.data() + (3 * std::size_t(ports_.pair_width));
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V tension = of<S>(ws_.tension, s), at = of<S>(ws_.at, s), by = tension - at;
            const V bent = shared_sums<S>(3, s) + 2.0 * shared_sums<S>(4, s), kappa = of<S>(ports_.kappa, s);
            V gained = shared_sums<S>(1, s) - by * (2.0 * shared_sums<S>(2, s) - by * bent);
            V falls = 2.0 * (shared_sums<S>(2, s) - by * bent), push{}, bends{};
            for (int p = s; p < n_ports(); p += ports_.strings) {
                const V f = of<S>(ports_.force, p), crossed = 4.0 * f, turns = port_sum<S>(4, p) + port_sum<S>(5, p);
                gained += crossed * (port_sum<S>(3, p) - by * turns), falls += crossed * turns;
            }
            // what pairs of forces give to the stretch: -2 f f' dZ/dT, and how it bends
            for (const auto& pair : ports_.pairs) {
                const V both = of<S>(ports_.force, pair.to_port + s) * of<S>(ports_.force, pair.from_port + s) *
                                  (pair.to == pair.from ? 2.0 : 4.0);
                push -= both * of<S>(ports_.slope, pair.pair + s), bends += size(both * S::load(third + pair.pair + s));
            }
            S::store(ws_.after.data() + s, gained), S::store(ws_.pushed.data() + s, push), S::store(ws_.sharp.data() + s, 0.5 * bends);
            const V least_tension = kappa * of<S>(ws_.stretch, s), over_most = of<S>(ports_.over_most, s);
            const V excess = tension - least_tension - kappa * (gained + push);
            const V reach = kFar * (at + over_most), steepness = most(1.0 + kappa * falls, V{} + 0.5);
            const V secant = (excess - of<S>(ws_.last_excess, s)) / (tension - of<S>(ws_.last_tension, s));
            S::store(ws_.last_excess.data() + s, excess), S::store(ws_.last_tension.data() + s, tension);
            const auto within = [&](V next) { return most(most(least(next, at + reach), at - reach), least_tension); };
            const V near = within(tension - excess / steepness);
            // that was at constant forces; a secant knows how they answer, and goes less far where it is steeper
            const V next = by_secant ? (secant > steepness ? within(tension - excess / secant) : near) : near;
            const V none = still(near, over_most);
            const auto stays = size(near - tension) <= none;
            S::store(ws_.tension.data() + s, stays ? tension : next);
            changed += stays ? V{} : V{} + 1.0;
        }
        return changed;
    }

    // Whether the sums of the visit tell the motion of all strings at the tensions found: what their polynomials leave
    // out is bounded by Cauchy's inequality. ws.far marks those where they do not.
    template <class S>
    bool all_close() {
        using V = typename S::V;
        V far{};
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V tension = of<S>(ws_.tension, s), at = of<S>(ws_.at, s), by = size(tension - at);
            const V kappa = of<S>(ports_.kappa, s);
            const V near = by / (of<S>(ports_.over_most, s) + least(tension, at)), stretch = of<S>(ws_.stretch, s);
            const V after = of<S>(ws_.after, s), all = stretch + after + size(of<S>(ws_.pushed, s));
            const V crossed = shared_sums<S>(3, s) * of<S>(ws_.sharp, s);  // of which the root is meant
            const V enough = 0.5 * kTensionTolerance * (tension + 1e-2 * kappa * all);
            const V left = enough - 36.0 * kappa * near * near * near * (shared_sums<S>(1, s) + stretch);
            const V lost = 12.0 * kappa * by * by;
            const V is_far = lost * lost * crossed <= left * left ? V{} : V{} + 1.0;
            const V marks = left >= 0.0 ? is_far : V{} + 1.0;
            const V mark = near <= kTold ? marks : V{} + 1.0;
            S::store(ws_.far.data() + s, mark);
            far += mark;
        }
        return S::sum(far) == 0.0;
    }

    // Newton's step of every tension; true if they were right already. `gain_of` adds what a component's stretch gains.
    template <class Gain>
    bool correct(int iteration, const Gain& gain_of) {
        bool found = true;
        for (int s = 0; s < n_strings(); ++s) {
            const auto& string = tensions_.strings[s];
            double after = ws_.stretch[s], slope = 0.0, size = after;
            for (const int i : string.components) gain_of(i, after, slope, size);
            const double excess = ws_.tension[s] - string.kappa * (after + ws_.stretch[s]);
            ws_.used[s] = ws_.tension[s];
            if (!(std::abs(excess) <= kTensionTolerance * (ws_.tension[s] + 1e-2 * string.kappa * size))) found = false;
            // the slope at constant forces first, then the secant, which knows how the forces answer
            double steepness = 1 - string.kappa * slope;
            if (iteration > 1) {
                const double secant = (excess - ws_.last_excess[s]) / (ws_.tension[s] - ws_.last_tension[s]);
                if (secant > 0.5 * steepness && secant < 2 * steepness) steepness = secant;
            }
            ws_.last_excess[s] = excess, ws_.last_tension[s] = ws_.tension[s];
            ws_.tension[s] = std::max(string.kappa * ws_.stretch[s], ws_.tension[s] - excess / steepness);
        }
        return found;
    }

    // The step is found, the port forces known. It is made at once where more than fixed ports and springs push.
    void finish_sample(const double* now) {
        std::swap(ws_.means[2], ws_.means[1]), std::swap(ws_.means[1], ws_.means[0]);
        std::copy(ws_.used.begin(), ws_.used.end(), ws_.means[0].begin());
        for (Part& part : parts_) {
            for (int p = 0; p < part.c->n_ports; ++p) part.forces[p] = now[part.port + p];
            part.pending = true;
            if (part.known->empty() && part.pushed->empty()) continue;
            Visit v;
            v.made = ws_.used[part.string], v.forces = part.forces, v.made_in = sample_;
            v.inputs = part.known->data(), v.n_inputs = int(part.known->size());
            v.loads = part.pushed->data(), v.n_loads = int(part.pushed->size());
            bring_near(part, v.made, kTold);
            visit<true, false, false>(*part.c, part.state, v);
            taut_.has_moved(part.slot);
            part.kept_at = v.made, part.pending = false;
        }
    }

    // Rows of a component from the first-th on.
    void rows(int i, int first, int b, double* lines) {
        using S = Simd;
        const Component& c = components_[i];
        double* line = lines + std::size_t(b) * layout_.width + layout_.row[i];
        const double *const sx = job_.modes[0] + c.offset, *const sy = job_.modes[1] + c.offset;
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

    // Coordinates before the step in ws.y, and in ws.u their sum with those after it without forces.
    void coordinates(int i) {
        using S = Simd;
        taut_.tell(i);
        const Component& c = components_[i];
        const int n = c.n;
        const double *const sx = job_.modes[0] + c.offset, *const sy = job_.modes[1] + c.offset;
        const double* const readings = c.stretched.reading.data();
        const double *const e00 = c.e.data(), *const e01 = e00 + n;
        double *const here = buffer(ws_.y, i), *const both = buffer(ws_.u, i);
        for (int k = 0; k < n; k += kWidth) {
            const V a = S::load(sx + k), reading = S::load(readings + k);
            V free = S::load(e00 + k) * a + S::load(e01 + k) * S::load(sy + k);
            for (const Input& in : known_[i]) free += S::load(in.vector + k) * in.values[sample_ * in.stride];
            S::store(here + k, reading * a);
            S::store(both + k, reading * (a + free));
        }
    }

    // The part of the gaps that the tensions do not change, gamma g - offset.
    void gaps_at_start(const double* lines) {
        std::fill(ws_.fixed.begin(), ws_.fixed.end(), 0.0);
        const double* line = lines + std::size_t(sample_) * layout_.width;
        for (const auto& t : tensions_.terms) {
            const double old = line[layout_.row[t.component] + t.port];
            ws_.fixed[t.connection] += solve_.gamma[t.connection] * t.factor * old;
            if (components_[t.component].stretched.on)
                ws_.fixed[t.connection] -= t.factor * old;  // their free displacement counts from the old one
            else
                ws_.fixed[t.connection] += t.factor * line[layout_.width + layout_.row[t.component] + t.port];
        }
        for (int j = 0; j < solve_.m; ++j) ws_.fixed[j] -= tensions_.offset[j];
    }

    // f = -M^-1 v, by an inverse made earlier in the block and corrections with M itself.
    bool solve_linear(const double* M, const double* v, double* f) {
        const int m = solve_.m;
        double *now = ws_.solution.data(), *wrong = ws_.wrong.data();
        for (int attempt = 0; attempt < 2; ++attempt) {
            const bool fresh = attempt > 0 || !ws_.inverted;
            if (fresh) invert(M);
            ws_.inverted = true;
            std::fill_n(now, m, 0.0);
            for (int correction = 0; correction < 12; ++correction) {
                double change = 0.0, size = 0.0;
                for (int i = 0; i < m; ++i) wrong[i] = -v[i] - dot(M + std::size_t(i) * m, now, m);
                for (int i = 0; i < m; ++i) {
                    const double sum = dot(ws_.inverse.data() + std::size_t(i) * m, wrong, m);
                    now[i] += sum;
                    change = std::max(change, std::abs(sum) * ws_.scale[i]);
                    size = std::max(size, std::abs(now[i]) * ws_.scale[i]);
                }
                if (change <= kForceTolerance * size) {
                    std::copy_n(now, m, f);
                    return true;
                }
            }
            if (fresh) break;  // or else the tensions have gone too far from where the inverse was made
        }
        std::copy_n(now, m, f);
        for (int i = 0; i < m; ++i)
            if (!std::isfinite(f[i])) return false;
        return true;
    }

    // ws.inverse of a matrix by Gauss and Jordan with pivots on the diagonal, after scaling it to ones there; a redundant
    // connection, whose pivot vanishes, takes no force. ws.scale holds the roots of the diagonal.
    void invert(const double* matrix) {
        const int m = solve_.m;
        double *a = ws_.inverse.data(), *d = ws_.scale.data();
        for (int j = 0; j < m; ++j) {
            d[j] = matrix[j * m + j] > 0.0 ? std::sqrt(matrix[j * m + j]) : 0.0;
            ws_.done[j] = 0;
        }
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j) a[i * m + j] = d[i] * d[j] > 0.0 ? matrix[i * m + j] / (d[i] * d[j]) : 0.0;
        for (int turn = 0; turn < m; ++turn) {
            int p = -1;
            for (int j = 0; j < m; ++j)
                if (!ws_.done[j] && (p < 0 || std::abs(a[j * m + j]) > std::abs(a[p * m + p]))) p = j;
            const double pivot = a[p * m + p];
            if (!(std::abs(pivot) > 1e-12)) break;
            ws_.done[p] = 1;
            a[p * m + p] = 1.0;
            for (int j = 0; j < m; ++j) a[p * m + j] /= pivot;
            for (int i = 0; i < m; ++i) {
                if (i == p) continue;
                const double ratio = a[i * m + p];
                a[i * m + p] = 0.0;
                for (int j = 0; j < m; ++j) a[i * m + j] -= ratio * a[p * m + j];
            }
        }
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j)
                a[i * m + j] = ws_.done[i] && ws_.done[j] ? a[i * m + j] / (d[i] * d[j]) : 0.0;
    }

    double* buffer(Array<double>& all, int i) const { return all.data() + components_[i].offset; }

    const std::vector<Component>& components_;
    const Layout& layout_;
    const Solve& solve_;
    const Tensions& tensions_;
    TensionSpace& ws_;
    TensePorts& ports_;
    Statistics& statistics_;
    const Job& job_;
    const std::vector<std::vector<Input>>& known_;
    int sample_ = 0;
    bool strong_ = false, linear_known_ = false, goes_on_ = false;
    double largest_ = 0.0;  // rise of a mode's stiffness
    const double* line_ = nullptr;
    const double *onto_ = ports_.onto_ports.data(), *fixed_ = ports_.fixed.data();
    Direct at_once_;
    Taut& taut_;
    std::vector<std::vector<Load>> pushed_;  // forces on guarded ports, by component
    std::vector<Part> parts_;  // string by string
    std::vector<int> part_of_ = std::vector<int>(components_.size(), -1);  // by component
    Array<double> forces_;                      // on fixed ports, of the step found last
};

}  // namespace
}  // namespace tonewood
