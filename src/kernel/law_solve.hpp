// Forces of the active nonlinear connections over one step; see tonewood.coupling.law_solve.
#pragma once

#include <cmath>

#include "laws.hpp"
#include "lines.hpp"

namespace tonewood {
namespace {

constexpr double kTolerance = 1e-12, kRounding = 4e-16;
constexpr int kMaxIterations = 100, kMaxSweeps = 200;

inline std::size_t wide(int n) { return std::size_t(n + kLane - 1) / kLane * kLane; }

// Cholesky of a (n, wide(n)), its lower triangle in place, a column of it in each row of `upper`, one over the diagonal
// in `over`; what lies beyond is zero. No pivot is below 1.
inline void factorize(double* a, int n, double* upper, double* over) {
    const std::size_t w = wide(n);
    for (int j = 0; j < n; ++j) {
        for (std::size_t i = j + 1; i < w; ++i) a[j * w + i] = 0.0;
        for (int i = 0; i < n; ++i) upper[j * w + i] = 0.0;
        for (int i = j; i < n; ++i) {
            double sum = a[i * w + j];
            for (int k = 0; k < j; ++k) sum -= a[i * w + k] * a[j * w + k];
            upper[j * w + i] = a[i * w + j] = i == j ? std::sqrt(std::max(sum, 1.0)) : sum * over[j];
            if (i == j) over[j] = 1 / a[i * w + j];
        }
        upper[j * w + j] = a[j * w + j] = 0.0;  // `over` stands for it
    }
}

// a x = b in place, a given by its factors
inline void solve_definite(const double* lower, const double* upper, const double* over, int n, double* b) {
    using S = Simd;
    const std::size_t w = wide(n);
    const auto subtract = [&](const double* row, double x, std::size_t from, std::size_t to) {
        for (std::size_t i = from / S::width * S::width; i < to; i += S::width)
            S::store(b + i, S::load(b + i) - S::load(row + i) * x);
    };
    for (int k = 0; k < n; ++k) subtract(upper + k * w, b[k] *= over[k], k, w);
    for (int k = n - 1; k >= 0; --k) subtract(lower + k * w, b[k] *= over[k], 0, k);
}

// Compliance between two connections, (k, k) in all, as both tell it.
inline double mutual(const double* z, int k, int i, int j) {
    return 0.5 * (z[std::size_t(i) * k + j] + z[std::size_t(j) * k + i]);
}

// Whether a law's force is linear in its compressions.
inline bool is_linear(const Law& law) { return law.kind == Law::spring && law.a[1] == 0.0 && law.a[2] == 0.0; }

// -s (I + s Z s)^-1 s for slopes s^2 of n laws, Z (n, wide(n)): (n, wide(n)) in ws.inverse. Uses ws.lower to ws.over.
inline void invert_laws(Workspace& ws, const double* z, const double* slope, int n) {
    const std::size_t w = wide(n);
    double *root = ws.x[4].data(), *lower = ws.lower.data();
    for (int i = 0; i < n; ++i) root[i] = std::sqrt(slope[i]);
    for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) lower[i * w + j] = root[i] * z[i * w + j] * root[j] + (i == j ? 1.0 : 0.0);
    factorize(lower, n, ws.upper.data(), ws.over.data());
    for (int i = 0; i < n; ++i) {
        double* row = ws.inverse.data() + i * w;
        std::fill_n(row, w, 0.0);
        row[i] = root[i];
        solve_definite(lower, ws.upper.data(), ws.over.data(), n, row);
        for (int j = 0; j < n; ++j) row[j] *= -root[j];
    }
}

// The forces f (n) of linear laws, in one step from where they stand: with force = slope p + f_0 it is
// r - s (I + s Z s)^-1 s Z r, s^2 = slope and r what is wrong. The inverse is kept until a slope changes.
inline bool solve_linear_laws(const Nonlinear& nl, Workspace& ws, const double* free, double* f) {
    const int n = int(ws.stored.size());
    const std::size_t w = wide(n);
    const double* z = ws.matrix.data();
    double *p = ws.x[0].data(), *r = ws.x[1].data(), *slope = ws.x[2].data(), *zr = ws.x[3].data();
    double* step = ws.x[5].data();
    std::fill_n(p, w, 0.0);
    add_product(z, int(w), f, n, p);
    for (int i = 0; i < n; ++i) {
        const int j = ws.stored[i];
        const Push out = push(nl.laws[j], free[i] - p[i], ws.old_p[j], nl.dt);
        r[i] = out.force * ws.scale[j] - f[i];
        const double now = out.slope * ws.scale[j];
        ws.factored = ws.factored && slope[i] == now;
        slope[i] = now;
    }
    if (!ws.factored) invert_laws(ws, z, slope, n);
    ws.factored = true;
    std::fill_n(zr, w, 0.0);
    add_product(z, int(w), r, n, zr);
    std::copy_n(r, n, step);
    add_product(ws.inverse.data(), int(w), zr, n, step);
    double check = 0.0;
    for (int i = 0; i < n; ++i) check += f[i] += step[i];
    return std::isfinite(check);
}

// Newton's method for the laws with a potential among the active: ws.stored, whose compliances stand in ws.matrix.
// `free` (n): compressions without these forces. Moves `f` (n).
inline bool newton(const Nonlinear& nl, Workspace& ws, const double* free, double* f, double noise, int& iterations) {
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
            const Push out = push(nl.laws[j], at_p[i], ws.old_p[j], nl.dt);
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
            // what the rounding of p makes of the forces: a dashpot over a short step lives on small differences
            double heard = 0.0;
            for (int j = 0; j < n; ++j)
                heard += std::abs(z[i * w + j]) * slope[j] * std::max(std::abs(p[j]), std::abs(ws.old_p[at[j]]));
            found = wrong <= allowed + kRounding * heard;
        }
        if (found) {
            iterations += iteration;
            return true;
        }
        for (int i = 0; i < n; ++i) s[i] = std::sqrt(slope[i]);
        for (int i = 0; i < n; ++i)
            for (int j = 0; j <= i; ++j) lower[i * w + j] = s[i] * z[i * w + j] * s[j] + (i == j ? 1.0 : 0.0);
        factorize(lower, n, ws.upper.data(), ws.over.data());
        ws.factored = false;
        std::fill_n(step, w, 0.0);
        for (int i = 0; i < n; ++i) step[i] = s[i] * zr[i];
        solve_definite(lower, ws.upper.data(), ws.over.data(), n, step);
        for (int i = 0; i < n; ++i) step[i] = r[i] - s[i] * step[i];
        times_z(step, moved);
        double start = 0.0, t = 1.0;
        for (int i = 0; i < n; ++i) start -= moved[i] * r[i];
        // the slope of the convex function along the step must have shrunk, or not yet turned
        for (int halved = 0;; ++halved) {
            double along = 0.0;
            for (int i = 0; i < n; ++i) tried[i] = p[i] - t * moved[i];
            evaluate(tried);
            for (int i = 0; i < n; ++i) along += moved[i] * (f[i] + t * step[i] - law_force[i]);
            if (along < 0.0 || std::abs(along) <= 0.9 * std::abs(start) || halved == 60) break;
            t *= 0.5;
        }
        for (int i = 0; i < n; ++i) f[i] += t * step[i], p[i] = tried[i];
    }
    return false;
}

// Finds ws.law_force of the connections in ws.active, friction on the branches of ws.branch, those open decided on the
// way; they start from what stands there. `z` (k, k): gaps per force.
inline bool find_forces(const Nonlinear& nl, Workspace& ws, const double* z, int& iterations) {
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
        ws.factored = false;
        if (at_rest) ws.gathered = ws.stored;
        else ws.gathered.clear();
    }
    bool linear = n_stored <= kMostLinear;
    for (int i = 0; i < n_stored && linear; ++i) linear = is_linear(nl.laws[ws.stored[i]]);
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
            if (linear) {
                ++iterations;
                if (!solve_linear_laws(nl, ws, free, g)) return false;
            } else if (!newton(nl, ws, free, g, noise, iterations)) {
                return false;
            }
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

// A friction law whose branch is none of its own under the motion found, moved to the one that is; -1 if there is none.
inline int misfit(const Nonlinear& nl, Workspace& ws) {
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

// Friction j at the velocity where its curve meets the force that the rest of the step asks for, by halving.
template <class Solve>
bool halve(const Nonlinear& nl, Workspace& ws, int j, const Solve& solve) {
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
    for (int turn = 0; turn < 200; ++turn) {
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

// A step with friction: solve() finds all else, friction on its branches. What slides at one tension or force of a
// contact may stick at the next, and so on for ever; so a branch is kept until all else is found, and only then looked
// at. For a velocity given the rest is a monotone problem, its force on friction rises with that velocity, and where it
// cannot stick the curve is met on the way to the velocity without friction: halving finds what changing does not.
template <class Solve>
bool settle(const Nonlinear& nl, Workspace& ws, const Solve& solve) {
    for (const int j : ws.active) ws.branch[j] = Branch::open;
    const int patience = 4;
    for (int turn = 0;; ++turn) {
        if (!solve()) return false;
        const int j = misfit(nl, ws);
        if (j < 0) return true;
        const int n = int(ws.sliding.size());
        if (turn >= (patience + 1) * n) return false;
        if (turn >= patience * n && !halve(nl, ws, j, solve)) return false;
    }
}

}  // namespace
}  // namespace tonewood
