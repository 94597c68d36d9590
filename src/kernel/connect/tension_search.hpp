// Search for the tensions and the forces on the ports of the strings, from the sums of their modal passes.
//
// All that other components and connections do is linear in the displacements d_p of the strings' ports, less what their
// compliance at rest gives for their forces:
//     d = sum r (U - x) + (Z(T) - Z(0)) f,      port forces = fixed part + onto^T d.
// The forces are a fixed point that contracts by the relative rise of the stiffness in each iteration, and the tension
// obeys T = kappa (S+ + S), solved by Newton's method.
#pragma once

#include "dense.hpp"
#include "tension_passes.hpp"

namespace tonewood {
namespace {

constexpr double kTensionTolerance = 1e-11;  // of the tension
constexpr double kForceTolerance = 1e-14;    // of the largest force
constexpr double kConverged = 1e-15;         // of a mode's stiffness, between two iterations
constexpr int kMaxIterationsPerPass = 100, kMaxTensionIterations = 200;
// relative changes of a mode's stiffness
constexpr double kFar = 0.1;        // that one pass may describe
constexpr double kInterval = 0.01;  // over an interval of the compliances
constexpr double kStrong = 0.05;    // beyond which forces are found by an inverse
constexpr double kSoft = 0.01;      // up to which forces and tensions are found side by side
constexpr double kForceLeft = 2.0;  // residual of the forces after an iteration, per relative rise of stiffness

template <class Number>
Number least(Number a, Number b) { return a < b ? a : b; }
template <class Number>
Number most(Number a, Number b) { return a > b ? a : b; }
template <class Number>
Number size(Number a) { return a < 0.0 ? -a : a; }

// Step of a tension that counts as none.
template <class Number>
Number negligible(Number tension, Number over_most) {
    return most(kConverged * most(over_most, 20.0 * tension), 0.2 * kTensionTolerance * tension);
}

class TensionSearch {
public:
    TensionSearch(Block& block, TensionPasses& passes)
        : components_(block.model.components), tensions_(block.model.tensions), ws_(block.model.tension),
          ports_(block.model.tension.ports), statistics_(block.model.statistics), passes_(passes) {}

    // The matrix and the fixed part that find_linear uses; laws may be folded in.
    void use(const double* onto, const double* fixed) { onto_ = onto, fixed_ = fixed; }
    void use_linear() { use(ports_.onto_ports.data(), ports_.fixed.data()); }

    // Finds tensions and forces where port forces are onto^T d and a fixed part. A product reduces the residual of the
    // forces by about three digits, a Newton step that of the tensions as far as the forces allow: two products for each
    // iteration. Where stiffness rises much, the forces converge first, so that a secant sees the tensions alone.
    bool find_linear() {
        return passes_.in_lanes([&]<class S>() { return find_linear<S>(); });
    }
    // Finds them where laws answer too: `answer` evaluates the forces from the displacements ports.alone and ports.moved.
    template <class Answer>
    bool find(double tolerance, const Answer& answer) {
        return passes_.in_lanes([&]<class S>() {
            return search<S>([&](bool& failed) {
                bool converged = false;
                for (int iteration = 0; !converged && !failed && iteration < kMaxIterationsPerPass; ++iteration) {
                    displacements<S>();
                    add_product(onto_, ports_.width, ports_.alone.data(), int(ports_.ports.size()), fixed_, ports_.base.data());
                    bool forces_converged = false;
                    failed = strong_ || !converge<S>(iteration == 0 ? 3 : kMaxIterationsPerPass, tolerance, answer, forces_converged);
                    converged = !failed && S::sum(step_tensions<S>(true)) == 0.0 && forces_converged;
                }
                return converged;
            });
        });
    }

    // Adds to ports.alone the displacements by forces.
    void add_moved() {
        for (int p = 0; p < int(ports_.ports.size()); ++p) ports_.alone[p] += ports_.moved[p];
    }

    bool count(int iterations, bool done) {
        statistics_.tension_iterations += iterations;
        statistics_.most_tension_iterations = std::max<std::int64_t>(statistics_.most_tension_iterations, iterations);
        return done;
    }

private:
    template <class S>
    bool find_linear() {
        using V = typename S::V;
        const int width = ports_.width, n = int(ports_.ports.size());
        double *const force = ports_.force.data(), *const next = ports_.next.data(), *const all = ports_.residual.data();
        const auto answer = [&](double* to) {
            move_ports<S>(force);
            for (int p = 0; p < n; p += S::width) S::store(all + p, of<S>(ports_.alone, p) + of<S>(ports_.moved, p));
            add_product(onto_, width, all, n, fixed_, to);
        };
        const auto iterate = [&](bool soft) {
            displacements<S>();
            if (strong_) invert_ports<S>();
            else answer(force);
            for (int product = 0; !strong_ && !soft && product < kMaxIterationsPerPass; ++product) {
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
            V sizes{}, remaining{};
            // forces are differences of the fixed part and what displacements add: rounded as these are
            for (int p = 0; p < n; p += S::width)
                sizes = most(sizes, most(size(S::load(next + p)), size(S::load(fixed_ + p))));
            const double enough = kForceTolerance * (strong_ ? 4 : 1) * S::largest(sizes);
            const double shrinks = strong_ ? 1.0 : std::min(1.0, kForceLeft * largest_);
            for (int p = 0; p < n; p += S::width) {
                const V now = S::load(next + p), residual = now - S::load(force + p);
                remaining += shrinks * size(residual) <= enough ? V{} : V{} + 1.0;
                S::store(all + p, residual);
                if (!strong_) S::store(force + p, now);
            }
            if (strong_) add_product(ports_.inverse.data(), width, all, n, force);
            return S::sum(remaining + step_tensions<S>(!soft)) == 0.0;
        };
        return search<S>([&](bool&) {
            const bool soft = largest_ <= kSoft;
            bool converged = false;
            for (int k = 0; !converged && k < kMaxIterationsPerPass; ++k) converged = iterate(soft);
            move_ports<S>(force);
            return converged;
        });
    }

    // `iterate` approaches tensions and forces until both have converged, or until it has `failed`. A string whose tension
    // is then too far from that of its pass is passed again.
    template <class S, class Iterate>
    bool search(const Iterate& iterate) {
        int iterations = 0;
        bool done = false, failed = false;
        while (!done && !failed && iterations++ < kMaxTensionIterations) {
            if (iterations == 1) {
                std::copy(ws_.at.begin(), ws_.at.end(), ws_.tension.begin());
                std::fill(ws_.last_tension.begin(), ws_.last_tension.end(), NAN);
            } else {
                for (int s = 0; s < passes_.n_strings(); ++s)
                    if (ws_.far[s] != 0.0) ws_.at[s] = ws_.tension[s], passes_.pass(s);
                passes_.reduce<S>();
            }
            if (is_beyond<S>()) continue;
            if (!expand<S>()) break;
            const bool converged = iterate(failed);
            const bool close = all_close<S>();
            done = converged && close, failed = failed || (close && !converged);
        }
        std::copy(ws_.tension.begin(), ws_.tension.end(), ws_.used.begin());
        return count(iterations, done);
    }

    // Whether a string's present stretch demands a tension beyond what its pass describes: ws.far marks such strings.
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

    // Evaluates the compliances less those at rest and two derivatives at the tensions of the passes. False if a tension
    // is no number.
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
            for (int s = 0; s < passes_.n_strings(); ++s) {
                if (!std::isfinite(ws_.at[s])) return false;
                enter_interval(s);
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

    // Displacements of the ports without port forces, and their compliances less those at rest, at the tensions tried.
    template <class S>
    void displacements() {
        using V = typename S::V;
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V by = of<S>(ws_.tension, s) - of<S>(ws_.at, s);
            for (int p = s; p < int(ports_.ports.size()); p += ports_.strings)
                S::store(ports_.alone.data() + p, port_sum<S>(1, p) - by * (port_sum<S>(2, p) - by * port_sum<S>(4, p)));
            for (int q = s; q < ports_.pair_width; q += ports_.strings) {
                const V slope = of<S>(ports_.slope_at, q), bend = by * of<S>(ports_.bend_at, q);
                S::store(ports_.change.data() + q, of<S>(ports_.change_at, q) + by * (slope + bend));
                S::store(ports_.slope.data() + q, slope + 2.0 * bend);
            }
        }
    }

    // Expands the compliances of a string anew if its tension has left the interval of the last expansion.
    void enter_interval(int s) {
        const double tension = ws_.at[s], most = ports_.most[s];
        if (tension >= ports_.low[s] && tension < ports_.high[s]) return;
        const auto begin = [&](int index) { return std::expm1(kInterval * index) / most; };
        int index = int(std::log1p(most * tension) / kInterval);
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

    // Fixed point of the forces that the displacements cause and of the displacements that the forces cause, at the
    // tensions tried. Each iteration contracts by about the largest relative rise of stiffness.
    template <class S, class Answer>
    bool converge(int iterations, double tolerance, const Answer& answer, bool& converged) {
        using V = typename S::V;
        double *const force = ports_.force.data(), *const next = ports_.next.data();
        const double shrinks = std::min(1.0, 2 * largest_);
        for (int k = 0; !converged && k < iterations; ++k) {
            move_ports<S>(force);
            if (!answer(next)) return false;
            V changes{}, sizes{}, check{};
            for (int p = 0; p < int(ports_.ports.size()); p += S::width) {
                const V now = S::load(next + p), change = size(now - S::load(force + p));
                changes = most(changes, change), sizes = most(sizes, size(now)), check += change;
                S::store(force + p, now);
            }
            if (!(S::sum(check) <= 1e300)) return false;
            converged = S::largest(changes) * shrinks <= tolerance * S::largest(sizes);
        }
        move_ports<S>(force);
        return true;
    }

    // ports.inverse^T = (I - onto^T (Z(T) - Z(0)))^-1; its diagonal dominates as that of 1 + a T w / 2.
    template <class S>
    void invert_ports() {
        const int n = int(ports_.ports.size()), w = ports_.width;
        double *const a = ports_.inverse.data(), *const unit = ports_.residual.data();
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
        invert(a, n, std::size_t(w), ports_.pivots.data());
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

    // Makes Newton's step of every tension at the forces found; the sum of the lanes counts those that changed.
    template <class S>
    auto step_tensions(bool by_secant) {
        using V = typename S::V;
        V changed{};
        const double* const third = ports_.changes.data() + (3 * std::size_t(ports_.pair_width));
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V tension = of<S>(ws_.tension, s), at = of<S>(ws_.at, s), by = tension - at;
            const V bent = shared_sums<S>(3, s) + 2.0 * shared_sums<S>(4, s), kappa = of<S>(ports_.kappa, s);
            V gained = shared_sums<S>(1, s) - by * (2.0 * shared_sums<S>(2, s) - by * bent);
            V falls = 2.0 * (shared_sums<S>(2, s) - by * bent), push{}, bends{};
            for (int p = s; p < int(ports_.ports.size()); p += ports_.strings) {
                const V f = of<S>(ports_.force, p), crossed = 4.0 * f, turns = port_sum<S>(4, p) + port_sum<S>(5, p);
                gained += crossed * (port_sum<S>(3, p) - by * turns), falls += crossed * turns;
            }
            // pairs of forces add -2 f f' dZ/dT to the stretch
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
            // that holds at constant forces; a secant includes their answer, and is shorter where it is steeper
            const V next = by_secant ? (secant > steepness ? within(tension - excess / secant) : near) : near;
            const V none = negligible(near, over_most);
            const auto stays = size(near - tension) <= none;
            S::store(ws_.tension.data() + s, stays ? tension : next);
            changed += stays ? V{} : V{} + 1.0;
        }
        return changed;
    }

    // Whether the sums of the passes describe the motion of all strings at the tensions found: the remainder of their
    // polynomials is bounded by Cauchy's inequality. ws.far marks the other strings.
    template <class S>
    bool all_close() {
        using V = typename S::V;
        V far{};
        for (int s = 0; s < ports_.strings; s += S::width) {
            const V tension = of<S>(ws_.tension, s), at = of<S>(ws_.at, s), by = size(tension - at);
            const V kappa = of<S>(ports_.kappa, s);
            const V near = by / (of<S>(ports_.over_most, s) + least(tension, at)), stretch = of<S>(ws_.stretch, s);
            const V after = of<S>(ws_.after, s), all = stretch + after + size(of<S>(ws_.pushed, s));
            const V crossed = shared_sums<S>(3, s) * of<S>(ws_.sharp, s);  // the square of the bound
            const V enough = 0.5 * kTensionTolerance * (tension + 1e-2 * kappa * all);
            const V left = enough - 36.0 * kappa * near * near * near * (shared_sums<S>(1, s) + stretch);
            const V lost = 12.0 * kappa * by * by;
            const V is_far = lost * lost * crossed <= left * left ? V{} : V{} + 1.0;
            const V marks = left >= 0.0 ? is_far : V{} + 1.0;
            const V mark = near <= kExpansion ? marks : V{} + 1.0;
            S::store(ws_.far.data() + s, mark);
            far += mark;
        }
        return S::sum(far) == 0.0;
    }

    const std::vector<Component>& components_;
    const Tensions& tensions_;
    TensionState& ws_;
    TensionPorts& ports_;
    Statistics& statistics_;
    TensionPasses& passes_;
    bool strong_ = false;
    double largest_ = 0.0;  // relative rise of a mode's stiffness
    const double *onto_ = ports_.onto_ports.data(), *fixed_ = ports_.fixed.data();
};

}  // namespace
}  // namespace tonewood
