// Forces of the active nonlinear connections over one step; see tonewood.physics.coupling.laws.solve.
#pragma once

#include <cmath>

#include "../dense.hpp"
#include "friction.hpp"
#include "kinds.hpp"

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
        (nl.laws[j].has_potential() ? ws.stored : ws.sliding).push_back(j);
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
            meet_friction(law, ws, j, without, mobility);
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

}  // namespace
}  // namespace tonewood
