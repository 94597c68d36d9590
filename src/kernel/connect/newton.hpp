// Forces of the active nonlinear connections over one step; see tonewood.physics.coupling.law_solve.
#pragma once

#include <cmath>

#include "dense.hpp"
#include "laws.hpp"

namespace tonewood {
namespace {

constexpr double kTolerance = 1e-12, kRounding = 4e-16;
constexpr int kMaxIterations = 100, kMaxSweeps = 200;

// Compliance between two connections, (k, k) in all, the mean of both entries.
inline double mutual(const double* z, int k, int i, int j) {
    return 0.5 * (z[std::size_t(i) * k + j] + z[std::size_t(j) * k + i]);
}

// -s (I + s Z s)^-1 s for slopes s^2 of n laws, Z (n, wide(n)): (n, wide(n)) in `inverse`. Uses ws.lower to ws.over.
inline void invert_laws(ContactState& ws, const double* z, const double* slope, int n, Array<double>& inverse) {
    const std::size_t w = wide(n);
    inverse.assign(n * w, 0.0);
    double *root = ws.x[4].data(), *lower = ws.lower.data();
    for (int i = 0; i < n; ++i) root[i] = std::sqrt(slope[i]);
    for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) lower[i * w + j] = root[i] * z[i * w + j] * root[j] + (i == j ? 1.0 : 0.0);
    factorize(lower, n, ws.upper.data(), ws.over.data());
    for (int i = 0; i < n; ++i) {
        double* row = inverse.data() + i * w;
        row[i] = root[i];
        solve_definite(lower, ws.upper.data(), ws.over.data(), n, row);
        for (int j = 0; j < n; ++j) row[j] *= -root[j];
    }
}

// Newton's method for the active laws with a potential: ws.stored, with the compliances in ws.matrix. `free` (n) holds
// the compressions without these forces. Moves `f` (n).
inline bool newton(const Nonlinear& nl, ContactState& ws, const double* free, double* f, double noise,
                   int& iterations) {
    const int n = int(ws.stored.size()), *at = ws.stored.data();
    const double* z = ws.matrix.data();
    double *p = ws.x[0].data(), *r = ws.x[1].data(), *s = ws.x[2].data(), *zr = ws.x[3].data();
    double *step = ws.x[4].data(), *moved = ws.x[5].data(), *law_force = ws.x[6].data(), *slope = ws.x[7].data();
    double *tried = ws.x[8].data(), *lower = ws.lower.data();
    const std::size_t w = wide(n);
    const auto times_z = [&](const double* v, double* out) {
        std::fill_n(out, w, 0.0);
        add_product(z, int(w), v, n, out);  // z is symmetric
    };
    const auto evaluate = [&](const double* at_p) {
        for (int i = 0; i < n; ++i) {
            const int j = at[i];
            const LawForce out = evaluate_law(nl.laws[j], at_p[i], ws.old_p[j], nl.dt);
            law_force[i] = out.force * ws.scale[j], slope[i] = out.slope * ws.scale[j];
        }
    };
    times_z(f, p);
    for (int i = 0; i < n; ++i) p[i] = free[i] - p[i];
    evaluate(p);
    for (int iteration = 0; iteration <= kMaxIterations; ++iteration) {
        double made = 0.0, check = 0.0;
        for (int i = 0; i < n; ++i) r[i] = law_force[i] - f[i];
        times_z(r, zr);
        for (int i = 0; i < n; ++i) {
            made = std::max(made, std::abs(free[i] - p[i]));
            check += zr[i];
        }
        if (!std::isfinite(check)) break;
        bool found = true;
        for (int i = 0; i < n && found; ++i) {
            const double allowed = kTolerance * made + noise, wrong = std::abs(zr[i]);
            if (wrong <= allowed) continue;
            // effect of the rounding of p on the forces: that of a dashpot depends on small differences
            double read_forces = 0.0;
            for (int j = 0; j < n; ++j)
                read_forces += std::abs(z[i * w + j]) * slope[j] * std::max(std::abs(p[j]), std::abs(ws.old_p[at[j]]));
            found = wrong <= allowed + kRounding * read_forces;
        }
        if (found) {
            iterations += iteration;
            return true;
        }
        for (int i = 0; i < n; ++i) s[i] = std::sqrt(slope[i]);
        for (int i = 0; i < n; ++i)
            for (int j = 0; j <= i; ++j) lower[i * w + j] = s[i] * z[i * w + j] * s[j] + (i == j ? 1.0 : 0.0);
        factorize(lower, n, ws.upper.data(), ws.over.data());
        std::fill_n(step, w, 0.0);
        for (int i = 0; i < n; ++i) step[i] = s[i] * zr[i];
        solve_definite(lower, ws.upper.data(), ws.over.data(), n, step);
        for (int i = 0; i < n; ++i) step[i] = r[i] - s[i] * step[i];
        times_z(step, moved);
        double start = 0.0, t = 1.0;
        for (int i = 0; i < n; ++i) start -= moved[i] * r[i];
        // the slope of the convex function along the step must have shrunk, or kept its sign
        for (int halved = 0;; ++halved) {
            double descent = 0.0;
            for (int i = 0; i < n; ++i) tried[i] = p[i] - t * moved[i];
            evaluate(tried);
            for (int i = 0; i < n; ++i) descent += moved[i] * (f[i] + t * step[i] - law_force[i]);
            if (descent < 0.0 || std::abs(descent) <= 0.9 * std::abs(start) || halved == 60) break;
            t *= 0.5;
        }
        for (int i = 0; i < n; ++i) f[i] += t * step[i], p[i] = tried[i];
    }
    return false;
}

// Finds ws.law_force of the connections in ws.active, starting from its values; friction keeps the branches of
// ws.branch, and open ones are decided. `z` (k, k): gaps per force.
inline bool find_forces(const Nonlinear& nl, ContactState& ws, const double* z, int& iterations) {
    const int k = nl.k, n = int(ws.active.size());
    double* f = ws.law_force.data();
    ws.stored.clear(), ws.sliding.clear();
    double noise = 0.0;
    for (const int j : ws.active) {
        (nl.laws[j].kind == Law::friction ? ws.sliding : ws.stored).push_back(j);
        noise = std::max(noise, kRounding * ws.size[j]);
    }
    const int n_stored = int(ws.stored.size());
    const bool at_rest = z == ws.z.data();
    if (!at_rest || ws.gathered != ws.stored) {
        const std::size_t w = wide(n_stored);
        for (int i = 0; i < n_stored; ++i)
            for (int j = 0; j < n_stored; ++j) ws.matrix[i * w + j] = mutual(z, k, ws.stored[i], ws.stored[j]);
        if (at_rest) ws.gathered = ws.stored;
        else ws.gathered.clear();
    }
    double *free = ws.x[9].data(), *g = ws.x[10].data(), *before = ws.x[11].data();
    for (int sweep = 0; sweep < kMaxSweeps; ++sweep) {
        for (int i = 0; i < n; ++i) before[i] = f[ws.active[i]];
        for (const int j : ws.sliding) {
            const Law& law = nl.laws[j];
            double p = ws.free_p[j];
            for (const int i : ws.active)
                if (i != j) p -= z[std::size_t(j) * k + i] * f[i];
            const double mobility = z[std::size_t(j) * k + j] / nl.dt;
            const double without = -(p - ws.old_p[j]) / nl.dt - ws.velocity[j];
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
            f[j] = mobility > 0.0 ? (v - without) / mobility : 0.0;
        }
        if (n_stored) {
            for (int i = 0; i < n_stored; ++i) {
                const int j = ws.stored[i];
                free[i] = ws.free_p[j], g[i] = f[j];
                for (const int q : ws.sliding) free[i] -= z[std::size_t(j) * k + q] * f[q];
            }
            if (!newton(nl, ws, free, g, noise, iterations)) return false;
            for (int i = 0; i < n_stored; ++i) f[ws.stored[i]] = g[i];
        }
        if (ws.sliding.empty() || n == 1) return true;
        double moved = 0.0, made = 0.0;
        for (const int j : ws.active) {
            double change = 0.0, all = 0.0;
            for (int i = 0; i < n; ++i) {
                const int q = ws.active[i];
                const double per = z[std::size_t(j) * k + q];
                change += per * (f[q] - before[i]), all += per * f[q];
            }
            moved = std::max(moved, std::abs(change)), made = std::max(made, std::abs(all));
        }
        if (moved <= kTolerance * made + noise) return true;
    }
    return false;
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
