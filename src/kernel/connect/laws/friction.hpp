// Dry friction: its curve, and its branches over a step (tonewood.physics.coupling.laws.friction).
#pragma once

#include "base.hpp"

namespace tonewood {
namespace {

// Largest v > 0 with v + load mu(v) = free; 0 if there is none.
inline double slide(const Law& law, double free, double load) {
    const double fixed = law.a[1], moving = law.a[2], a = law.a[3];
    const double linear = a + load * moving - free, constant = a * (load * fixed - free);
    const double square = linear * linear - 4 * constant;
    if (square < 0.0) return 0.0;
    const double root = std::sqrt(square);
    const double v = linear <= 0.0 ? 0.5 * (root - linear) : -2 * constant / (linear + root);
    return v > 0.0 ? v : 0.0;
}

// The same, continued continuously in `free` and `load` where there is no such v.
inline double slide_on(const Law& law, double free, double load) {
    const double v = slide(law, free, load), a = law.a[3];
    return v > 0.0 ? v : std::max(std::sqrt(load * (law.a[1] - law.a[2]) * a) - a, 0.0);
}

// Relative velocity over the step, 0 for sticking; the branch of the step before is kept while it has a solution.
inline double velocity_after(const Law& law, double free, double load, double before) {
    if (before != 0.0) {
        const double side = before > 0.0 ? 1.0 : -1.0, v = slide(law, side * free, load);
        if (v > 0.0) return side * v;
    }
    if (std::abs(free) <= load * law.a[1]) return 0.0;
    const double side = free > 0.0 ? 1.0 : -1.0;
    return side * slide(law, side * free, load);
}

// Velocity and force of friction j at a velocity `without` its own force, on its branch; an open one is decided.
inline void meet_friction(const Law& law, ContactState& ws, int j, double without, double mobility) {
    const double load = mobility * law.a[0] * ws.scale[j];
    Branch& branch = ws.branch[j];
    double v = 0.0;
    switch (branch) {
        case Branch::open:
            v = velocity_after(law, without, load, ws.slip[j]);
            branch = v == 0.0 ? Branch::stuck : v > 0.0 ? Branch::ahead : Branch::behind;
            break;
        case Branch::stuck: break;
        case Branch::ahead: v = slide_on(law, without, load); break;
        case Branch::behind: v = -slide_on(law, -without, load); break;
        case Branch::held: v = ws.held[j];
    }
    ws.slip_after[j] = v, ws.without[j] = without, ws.load[j] = load;
    ws.law_force[j] = mobility > 0.0 ? (v - without) / mobility : 0.0;
}

// Finds a friction law whose branch does not fit the motion found and moves it to the branch that does; -1 if there is
// none.
inline int wrong_branch(const Nonlinear& nl, ContactState& ws) {
    for (const int j : ws.sliding) {
        const double free = ws.without[j], load = ws.load[j];
        const Branch branch = ws.branch[j];
        const bool may_stick = std::abs(free) <= load * nl.laws[j].a[1];
        if (branch == Branch::held || (branch == Branch::stuck && may_stick)) continue;
        if (branch != Branch::stuck && slide(nl.laws[j], branch == Branch::ahead ? free : -free, load) > 0.0) continue;
        const Branch next = may_stick ? Branch::stuck : free > 0.0 ? Branch::ahead : Branch::behind;
        if (next == branch) continue;
        ws.branch[j] = next;
        return j;
    }
    return -1;
}

// Bisects the velocity of friction j where its curve meets the force that the rest of the step needs.
template <class Solve>
bool bisect(const Nonlinear& nl, ContactState& ws, int j, const Solve& solve) {
    const Law& law = nl.laws[j];
    const double load = law.a[0] * ws.scale[j], fixed = law.a[1], moving = law.a[2];
    const auto hold = [&](double v) {
        ws.branch[j] = Branch::held, ws.held[j] = v;
        return solve();
    };
    if (!hold(0.0)) return false;
    const double force = ws.law_force[j];
    if (std::abs(force) <= load * fixed) return true;
    const double side = force < 0.0 ? 1.0 : -1.0;
    double low = 0.0, high = std::abs(ws.without[j]);
    bool bracketed = false;
    for (int iteration = 0; iteration < 200; ++iteration) {
        const double v = bracketed ? 0.5 * (low + high) : high;
        if (v == low || (bracketed && v == high)) break;
        if (!hold(side * v)) return false;
        const bool is_short = side * ws.law_force[j] + load * (moving + (fixed - moving) / (1 + v / law.a[3])) < 0.0;
        bracketed = bracketed || !is_short;
        (is_short ? low : high) = v;
        if (!bracketed) high = 2 * v;
    }
    return bracketed;
}

// A step with friction: solve() finds everything else with friction on given branches. Branches that changed within the
// iteration could alternate for ever, so each is kept until everything else is found and is then tested. At a given
// velocity the rest is a monotone problem whose force on friction rises with that velocity; where sticking is
// impossible the curve is met before the velocity without friction, and bisection finds it where changing branches does
// not.
template <class Solve>
bool converge_branches(const Nonlinear& nl, ContactState& ws, const Solve& solve) {
    for (const int j : ws.active) ws.branch[j] = Branch::open;
    const int patience = 4;
    for (int iteration = 0;; ++iteration) {
        if (!solve()) return false;
        const int j = wrong_branch(nl, ws);
        if (j < 0) return true;
        const int n = int(ws.sliding.size());
        if (iteration >= (patience + 1) * n) return false;
        if (iteration >= patience * n && !bisect(nl, ws, j, solve)) return false;
    }
}

}  // namespace
}  // namespace tonewood
