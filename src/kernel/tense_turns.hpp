// The search for tensions and forces of linear connections where stiffness rises little, for strings that one vector of
// lanes S holds, of C components with P fixed ports each: all numbers of a turn stay in registers.
//
// A product onto^T d leaves of what is wrong with the forces about the largest relative rise of a mode's stiffness, and
// Newton's step at constant forces as much of what is wrong with a tension. So the last turn is known for it beforehand.
#pragma once

#include "lines.hpp"

namespace tonewood {
namespace {

constexpr double kTensionTolerance = 1e-11;  // of the tension
constexpr double kForceTolerance = 1e-14;  // of the largest force
constexpr double kSettled = 1e-15;  // of a mode's stiffness, between two turns
constexpr double kFar = 0.1;  // relative change of a mode's stiffness that may be tried with the sums of one visit
constexpr int kMaxTurns = 100;
// at most left of what is wrong with forces and tensions after each turn, per relative rise of stiffness
constexpr double kForceLeft = 2.0, kTensionLeft = 4.0;

template <class Number>
Number least(Number a, Number b) { return a < b ? a : b; }
template <class Number>
Number most(Number a, Number b) { return a > b ? a : b; }
template <class Number>
Number size(Number a) { return a < 0.0 ? -a : a; }

// Step of a tension that need not be told from none.
template <class Number>
Number still(Number tension, Number over_most) {
    return most(kSettled * most(over_most, 20.0 * tension), 0.2 * kTensionTolerance * tension);
}

template <class S, int C, int P>
class SoftTurns {
    using V = typename S::V;
    static constexpr int n = C * P, n_pairs = C * P * (P + 1) / 2;
    static_assert(P == 1 || P == 2);

public:
    SoftTurns(TensePorts& ports, TensionSpace& ws, const double* onto, const double* fixed)
        : ports_(ports), ws_(ws), onto_(onto), at_(S::load(ws.at.data() + 0)), tension_(S::load(ws.tension.data() + 0)) {
        for (int p = 0; p < n; ++p) {
            fixed_[p] = S::load(fixed + p * S::width);
            force_[p] = S::load(ports.force.data() + (p * S::width));
        }
    }

    // True if it ended; tensions, forces, and displacements without and by forces are as in a turn of the other kind.
    bool operator()(double largest) {
        const double left = kForceLeft * largest, tension_left = kTensionLeft * largest;
        bool done = false;
        for (int turn = 0; turn < kMaxTurns && !done; ++turn) {
            move();
            V before[n], sizes{}, unsettled{};
            answer();
            for (int p = 0; p < n; ++p) before[p] = force_[p];
            answer();
            for (int p = 0; p < n; ++p) sizes = most(sizes, most(size(force_[p]), size(fixed_[p])));
            const double enough = kForceTolerance * S::largest(sizes);
            for (int p = 0; p < n; ++p)
                unsettled += left * left * size(force_[p] - before[p]) <= enough ? V{} : V{} + 1.0;
            done = S::sum(unsettled + raise(tension_left)) == 0.0;
        }
        move();
        answer();
        S::store(ws_.tension.data() + 0, tension_), S::store(ws_.after.data() + 0, gained_), S::store(ws_.pushed.data() + 0, push_);
        V sharp{};
        each_pair([&](int pair, int to, int from) {
            const V third = S::load(ports_.changes.data() + (3 * std::size_t(ports_.pair_width) + pair * S::width));
            sharp += size(force_[to] * force_[from] * third) * (to == from ? 1.0 : 2.0);
        });
        S::store(ws_.sharp.data() + 0, sharp);
        V moved[n];
        follow(moved);
        for (int p = 0; p < n; ++p) {
            S::store(ports_.alone.data() + (p * S::width), alone_[p]), S::store(ports_.moved.data() + (p * S::width), moved[p]);
            S::store(ports_.force.data() + (p * S::width), force_[p]);
        }
        return done;
    }

private:
    // in the order of TensePorts::pairs
    template <class Use>
    static void each_pair(const Use& use) {
        for (int p = 0; p < n; ++p) use(p, p, p);
        if constexpr (P == 2)
            for (int c = 0; c < C; ++c) use(n + c, 2 * c, 2 * c + 1);
    }
    V sum(int kind, int p) const {
        return S::load(ports_.sums.data() + (kSharedSums * S::width + (std::size_t(kind) * n + p) * S::width));
    }
    V shared(int kind) const { return S::load(ports_.sums.data() + (std::size_t(kind) * S::width)); }

    // To the tensions tried.
    void move() {
        const V by = tension_ - at_;
        for (int p = 0; p < n; ++p) alone_[p] = sum(1, p) - by * (sum(2, p) - by * sum(4, p));
        for (int q = 0; q < n_pairs; ++q) {
            const V slope = S::load(ports_.slope_at.data() + (q * S::width)), bend = by * S::load(ports_.bend_at.data() + (q * S::width));
            change_[q] = S::load(ports_.change_at.data() + (q * S::width)) + by * (slope + bend);
            slope_[q] = slope + 2.0 * bend;
        }
    }

    // What the forces move.
    void follow(V* moved) const {
        each_pair([&](int pair, int to, int from) {
            if (to == from) {
                moved[to] = change_[pair] * force_[to];
            } else {
                moved[to] += change_[pair] * force_[from];
                moved[from] += change_[pair] * force_[to];
            }
        });
    }

    // The forces that all displacements call up.
    void answer() {
        V moved[n], sums[2][n] = {};
        follow(moved);
        alignas(64) double all[n * S::width];
        for (int p = 0; p < n; ++p) S::store(all + p * S::width, alone_[p] + moved[p]), sums[0][p] = fixed_[p];
        const double* row = onto_;
#pragma GCC unroll 8
        for (int q = 0; q < n * S::width; ++q, row += ports_.width)
            for (int p = 0; p < n; ++p) sums[q % 2][p] += S::load(row + p * S::width) * all[q];
        for (int p = 0; p < n; ++p) force_[p] = sums[0][p] + sums[1][p];
    }

    // Newton's step of every tension; marks those that another one may still change by more than nothing.
    V raise(double left) {
        const V by = tension_ - at_, kappa = S::load(ports_.kappa.data() + 0), over_most = S::load(ports_.over_most.data() + 0);
        const V bent = shared(3) + 2.0 * shared(4), stretch = S::load(ws_.stretch.data() + 0);
        V gained = shared(1) - by * (2.0 * shared(2) - by * bent), falls = 2.0 * (shared(2) - by * bent), push{};
        for (int p = 0; p < n; ++p) {
            const V crossed = 4.0 * force_[p], turns = sum(4, p) + sum(5, p);
            gained += crossed * (sum(3, p) - by * turns), falls += crossed * turns;
        }
        each_pair([&](int pair, int to, int from) {
            push -= force_[to] * force_[from] * slope_[pair] * (to == from ? 2.0 : 4.0);
        });
        gained_ = gained, push_ = push;
        const V least_tension = kappa * stretch, excess = tension_ - least_tension - kappa * (gained + push);
        const V reach = kFar * (at_ + over_most), steepness = most(1.0 + kappa * falls, V{} + 0.5);
        const V next = most(most(least(tension_ - excess / steepness, at_ + reach), at_ - reach), least_tension);
        const V step = size(next - tension_);
        tension_ = next;
        return left * step <= still(next, over_most) ? V{} : V{} + 1.0;
    }

    TensePorts& ports_;
    TensionSpace& ws_;
    const double* onto_;
    V at_, tension_, gained_, push_, fixed_[n], force_[n], alone_[n], change_[n_pairs], slope_[n_pairs];
};

}  // namespace
}  // namespace tonewood
