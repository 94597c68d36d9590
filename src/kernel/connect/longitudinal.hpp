// Samples of strings with longitudinal motion; the equations are in tonewood.coupling.geometric.
//
// The modal forces F of a step are a fixed point: for given F everything else is the general step with other free motion,
// and the motion found gives F anew. Where the tension rises little the map is nearly constant. Anderson's method
// extrapolates from the differences between evaluations, answer orthogonal as they come; strong plucks need it.
#pragma once

#include <algorithm>
#include <cmath>

#include "general_step.hpp"

namespace tonewood {
namespace {

constexpr double kGeometricTolerance = 1e-12;  // of the forces' norm, in displacements they make
constexpr double kBelowRounding = 1e-16;        // of the coordinates before the step: below the rounding of the state
constexpr int kMaxGeometricIterations = 400;
constexpr int kGeometricMemory = 14;           // differences kept; all are dropped when there are more

class LongitudinalStep : public ConnectionStep {
    using S = Simd;

public:
    LongitudinalStep(Block& block, LawForces& laws)
        : block_(block), components_(block.model.components), layout_(block.model.layout),
          geometric_(block.model.geometric), statistics_(block.model.statistics), laws_(laws), general_(block, laws) {
        for (const auto& given : geometric_.strings) {
            String string;
            int at = 0;
            for (const auto& g : given.parts) {
                Part part;
                part.given = &g, part.at = at;
                const Component& c = components_[g.component];
                const int n = g.width, reach = g.cosines_width + 2 * given.order + kLane;
                at += n;
                for (Array<double>* a : {&part.before, &part.free, &part.after}) a->assign(n, 0.0);
                part.fx.assign(c.n, 0.0), part.fy.assign(c.n, 0.0);
                part.rest.assign(c.n_ports, 0.0);
                part.slope.assign(2 * std::size_t(reach), 0.0);
                part.force.assign(g.cosines_width, 0.0);
                string.parts.push_back(std::move(part));
            }
            string.given = &given, string.n = at;
            const std::size_t order = given.order + 1;
            for (Array<double>* a : {&string.old_sums, &string.sums, &string.old_strain, &string.strain, &string.mean_tension})
                a->assign((order + kLane) / kLane * kLane, 0.0);
            for (Array<double>* a : {&string.F, &string.answer, &string.residual, &string.last_answer, &string.last_residual,
                                     &string.preconditioner, &string.weight})
                a->assign(at, 0.0);
            string.q.assign(std::size_t(kGeometricMemory) * at, 0.0), string.p = string.q;
            for (const Part& part : string.parts)
                std::copy(part.given->compliances.begin(), part.given->compliances.end(), string.weight.begin() + part.at);
            strings_.push_back(std::move(string));
        }
    }

    bool sample(int b, double* now, double* f_out) override {
        for (String& s : strings_) begin(s, b);
        if (!laws_.keeping_branches([&] { return solve(b, now); })) return false;
        laws_.commit(b);
        for (String& s : strings_)
            for (Part& part : s.parts) move(s, part, now);
        std::copy_n(block_.f.begin(), block_.model.solve.m, f_out);
        return true;
    }

    // Rows of the strings at the end of a block.
    void finish_block() override {
        for (String& s : strings_)
            for (Part& part : s.parts)
                rows(part, block_.nb, x(part), y(part), components_[part.given->component].n_rows);
    }

private:
    struct Part {
        const Geometric::Part* given = nullptr;
        int at = 0;                         // of its coordinates among the string's
        Array<double> before, free, after;  // coordinates
        Array<double> fx, fy;               // state without forces
        Array<double> rest;                 // ports without forces
        Array<double> slope;                // even continuation of the slope's cosines before and after
        Array<double> force;                // on the cosines
    };
    struct String {
        const Geometric::String* given = nullptr;
        int n = 0, kept = 0;
        bool fresh = true, has_last = false, converged = false;
        double left = 0, motion = 0;
        std::vector<Part> parts;                              // the longitudinal one last
        Array<double> old_sums, sums, old_strain, strain, mean_tension;  // s_n and l_n before and after, tension by n
        Array<double> F, answer, residual, last_answer, last_residual;  // forces, those of the motion under them, the difference
        Array<double> preconditioner, weight;                          // displacement per force
        Array<double> q, p;                                   // (kGeometricMemory, n) differences of residual, of answer
    };

    double* x(const Part& p) const { return block_.x(p.given->component); }
    double* y(const Part& p) const { return block_.y(p.given->component); }

    bool count(int iterations, bool done) {
        statistics_.longitudinal_iterations += iterations;
        statistics_.most_longitudinal_iterations = std::max<std::int64_t>(statistics_.most_longitudinal_iterations, iterations);
        statistics_.failures += !done;
        return done;
    }

    void rows(const Part& part, int b, const double* sx, const double* sy, int count) const {
        const Component& c = components_[part.given->component];
        double* line = block_.line(b) + layout_.row[part.given->component];
        for (int r = 0; r < count; ++r) line[r] = row(c, r, sx, sy);
    }
    static double row(const Component& c, int r, const double* sx, const double* sy) {
        using V = Simd;
        const double *rx = c.rows.data() + 2 * std::size_t(r) * c.n, *ry = rx + c.n;
        Simd::V sum{}, more{};
        for (int k = 0; k < c.n; k += V::width) {
            sum += V::load(rx + k) * V::load(sx + k);
            more += V::load(ry + k) * V::load(sy + k);
        }
        return V::sum(sum + more);
    }

    // Modal forces of sample b, and the forces of connections and ports with them. False if they were not found.
    bool solve(int b, double* now) {
        for (String& s : strings_) s.kept = 0, s.has_last = s.converged = false, s.left = INFINITY;
        bool found = false;
        int iteration = 0;
        bool final = false;
        while (!found && iteration++ < kMaxGeometricIterations) {
            for (String& s : strings_)
                if (!s.converged) place(s, b);
            if (!general_.forces(b, now)) return false;
            found = true;
            bool passed_over = false;
            // a converged string is passed over until all have converged, and is then evaluated under the final port forces
            for (String& s : strings_) {
                if (s.converged && !final) {
                    passed_over = true;
                    continue;
                }
                evaluate(s, now);
                const double left = norm(s, s.residual), all = norm(s, s.F);
                if (!std::isfinite(left)) return count(iteration, false);
                if (iteration == 1 && left > all) {  // forces of the free motion are far too large: start from those before the step
                    for (Part& part : s.parts) part.after = part.before;
                    respond(s);
                    s.F = s.answer, s.fresh = true, found = false;
                    continue;
                }
                const bool stagnant = left >= 0.5 * s.left && left <= 1e3 * kGeometricTolerance * all;
                // no nearer: other strings have moved it meanwhile, and the differences kept are not its own
                if (left > 0.9 * s.left) s.kept = 0, s.has_last = false;
                s.left = left;
                s.converged = left <= kGeometricTolerance * all || left <= kBelowRounding * s.motion || stagnant;
                if (!s.converged) advance(s), found = false;
            }
            final = found && passed_over;
            if (final) found = false;
        }
        return count(iteration, found);
    }

    // Free motion of a sample, and forces to start from.
    void begin(String& s, int b) {
        using V = Simd;
        for (Part& part : s.parts) {
            const int i = part.given->component;
            const Component& c = components_[i];
            const double *sx = x(part), *sy = y(part);
            rows(part, b, sx, sy, c.n_rows);
            for (int k = 0; k < c.n; k += V::width) {
                const auto a = V::load(sx + k), d = V::load(sy + k);
                auto nx = V::load(c.e.data() + k) * a + V::load(c.e.data() + c.n + k) * d;
                auto ny = V::load(c.e.data() + 2 * c.n + k) * a + V::load(c.e.data() + 3 * c.n + k) * d;
                for (const Input& in : block_.inputs[i]) {
                    const double value = in.values[b * in.stride];
                    nx += V::load(in.vector + k) * value, ny += V::load(in.vector + c.n + k) * value;
                }
                V::store(part.fx.data() + k, nx), V::store(part.fy.data() + k, ny);
            }
            for (int p = 0; p < c.n_ports; ++p) part.rest[p] = row(c, p, part.fx.data(), part.fy.data());
            for (int k = 0; k < part.given->n; ++k) {
                part.before[k] = part.given->reading[k] * sx[k];
                part.free[k] = part.given->reading[k] * part.fx[k];
            }
            part.after = part.free;
        }
        std::fill(s.old_sums.begin(), s.old_sums.end(), 0.0);
        if (s.given->longitudinal) {
            for (std::size_t q = 0; q + 1 < s.parts.size(); ++q) {
                spread(s, s.parts[q], s.parts[q].before, 0);
                add_sums(s, s.parts[q], 0, s.old_sums.data());
            }
            strain(s, s.parts.back().before, s.old_strain);
        } else {
            for (const Part& part : s.parts) s.old_sums[0] += stretch_of(part, part.before);
        }
        respond(s);
        s.F = s.answer, s.fresh = true;
        s.motion = 0.0;
        for (const Part& part : s.parts)
            for (int k = 0; k < part.given->n; ++k)
                s.motion += part.before[k] * part.before[k] / part.given->compliances[k];
        s.motion = std::sqrt(s.motion);
    }

    // Writes the port rows after the step under the modal forces, without port forces.
    void place(const String& s, int b) const {
        for (const Part& part : s.parts) {
            const int i = part.given->component;
            double* line = block_.line(b + 1) + layout_.row[i];
            for (int p = 0; p < components_[i].n_ports; ++p)
                line[p] = part.rest[p] + dot(part.given->to_port.data() + std::size_t(p) * part.given->width, s.F.data() + part.at,
                                             part.given->width);
        }
    }

    // Evaluates the forces of the motion under F and the port forces, and their difference to F.
    void evaluate(String& s, const double* now) {
        for (Part& part : s.parts) {
            const auto& g = *part.given;
            const double* forces = now + layout_.port[g.component];
            const double* F = s.F.data() + part.at;
            for (int k = 0; k < g.width; k += S::width)
                S::store(part.after.data() + k, S::load(part.free.data() + k) + S::load(g.compliances.data() + k) * S::load(F + k));
            add_product(g.from_port.data(), g.width, forces, components_[g.component].n_ports, part.after.data());
        }
        respond(s);
        for (int k = 0; k < s.n; ++k) s.residual[k] = s.answer[k] - s.F[k];
        if (!s.fresh) return;
        s.fresh = false;
        const double tension = std::max(s.mean_tension[0], 0.0);
        for (const Part& part : s.parts)
            for (int k = 0; k < part.given->width; ++k)
                s.preconditioner[part.at + k] = 1 / (1 + 0.5 * tension * part.given->compliances[k] * part.given->stretch[k]);
    }

    // Evaluates the forces s.answer at the coordinates `before` and `after`.
    void respond(String& s) {
        if (!s.given->longitudinal) return rise(s);
        const int order = s.given->order;
        std::fill(s.sums.begin(), s.sums.end(), 0.0);
        for (std::size_t q = 0; q + 1 < s.parts.size(); ++q) {
            spread(s, s.parts[q], s.parts[q].after, 1);
            add_sums(s, s.parts[q], 1, s.sums.data());
        }
        strain(s, s.parts.back().after, s.strain);
        Part& axial = s.parts.back();
        for (int n = 0; n <= order; ++n) {
            const double weight = s.given->scale * (n == 0 ? 1.0 : 0.5), sum = 0.5 * (s.old_sums[n] + s.sums[n]);
            s.mean_tension[n] = weight * (sum + 0.5 * (s.old_strain[n] + s.strain[n]));
            axial.force[n] = -weight * sum;
        }
        std::fill(s.answer.begin(), s.answer.end(), 0.0);
        const auto& g = *axial.given;
        add_product(g.back.data(), g.width, axial.force.data(), order + 1, s.answer.data() + axial.at);
        for (std::size_t q = 0; q + 1 < s.parts.size(); ++q) {
            Part& part = s.parts[q];
            const auto& h = *part.given;
            const double *old = middle(s, part, 0), *now = middle(s, part, 1);
            const double first = -0.5 * s.mean_tension[0];
            for (int i = 0; i < h.cosines_width; i += S::width) {
                S::V sum = (S::load(old + i) + S::load(now + i)) * first;
                for (int n = 1; n <= order; ++n)
                    sum -= (S::load(old + i - n) + S::load(old + i + n) + S::load(now + i - n) + S::load(now + i + n)) *
                           (0.5 * s.mean_tension[n]);
                S::store(part.force.data() + i, sum);
            }
            add_product(h.back.data(), h.width, part.force.data(), h.cosines, s.answer.data() + part.at);
        }
    }

    // The same without longitudinal motion.
    static void rise(String& s) {
        s.sums[0] = 0.0;
        for (const Part& part : s.parts) s.sums[0] += stretch_of(part, part.after);
        s.mean_tension[0] = 0.5 * s.given->scale * (s.old_sums[0] + s.sums[0]);
        for (const Part& part : s.parts)
            for (int k = 0; k < part.given->width; k += S::width)
                S::store(s.answer.data() + part.at + k, (S::load(part.before.data() + k) + S::load(part.after.data() + k)) *
                                                   S::load(part.given->stretch.data() + k) * (-0.5 * s.mean_tension[0]));
    }

    // Its s_0.
    static double stretch_of(const Part& part, const Array<double>& coordinates) {
        S::V sum{};
        for (int k = 0; k < part.given->width; k += S::width) {
            const S::V y = S::load(coordinates.data() + k);
            sum += S::load(part.given->stretch.data() + k) * y * y;
        }
        return 0.5 * S::sum(sum);
    }

    // The slope's cosines, halved but for the first and continued evenly, at `which` of before and after.
    static double* middle(const String& s, Part& part, int which) {
        const int reach = part.given->cosines_width + 2 * s.given->order + kLane;
        return part.slope.data() + std::size_t(which) * reach + s.given->order;
    }
    static void spread(const String& s, Part& part, const Array<double>& coordinates, int which) {
        const auto& g = *part.given;
        double* c = middle(s, part, which);
        std::fill_n(c, g.cosines_width, 0.0);
        add_product(g.slopes.data(), g.cosines_width, coordinates.data(), g.n, c);
        for (int i = 1; i < g.cosines; ++i) c[i] *= 0.5;
        for (int i = 1; i <= s.given->order; ++i) c[-i] = c[i];
    }

    // sums[n] += c^T H_n c / 2
    static void add_sums(const String& s, Part& part, int which, double* sums) {
        const double* c = middle(s, part, which);
        const int width = part.given->cosines_width;
        for (int n = 0; n <= s.given->order; ++n) {
            S::V sum{};
            for (int i = 0; i < width; i += S::width)
                sum += S::load(c + i) * (S::load(c + i - n) + S::load(c + i + n));
            // the first cosine alone is not halved, and half of it was taken
            const double all = S::sum(sum) - 0.5 * c[0] * (c[-n] + c[n]);
            sums[n] += n == 0 ? 0.5 * all : all;
        }
    }

    static void strain(const String& s, const Array<double>& coordinates, Array<double>& out) {
        const auto& g = *s.parts.back().given;
        std::fill(out.begin(), out.end(), 0.0);
        add_product(g.slopes.data(), g.cosines_width, coordinates.data(), g.n, out.data());
    }

    static double dot(const double* a, const double* b, int n) {
        S::V sum{};
        for (int k = 0; k < n; k += S::width) sum += S::load(a + k) * S::load(b + k);
        return S::sum(sum);
    }
    static double inner(const String& s, const double* a, const double* b) {
        S::V sum{};
        for (int k = 0; k < s.n; k += S::width) sum += S::load(s.weight.data() + k) * S::load(a + k) * S::load(b + k);
        return S::sum(sum);
    }
    static double norm(const String& s, const Array<double>& a) { return std::sqrt(inner(s, a.data(), a.data())); }

    static void subtract(double* a, double factor, const double* b, int n) {
        for (int k = 0; k < n; k += S::width) S::store(a + k, S::load(a + k) - S::load(b + k) * factor);
    }

    // The next F: s.answer less the part that the differences so far explain.
    static void advance(String& s) {
        const int n = s.n;
        for (int k = 0; k < n; ++k) {
            s.residual[k] *= s.preconditioner[k];
            s.answer[k] = s.F[k] + s.residual[k];
        }
        if (s.kept == kGeometricMemory) {
            s.kept = 0;
        } else if (s.has_last) {
            double *q = s.q.data() + (std::size_t(s.kept) * n), *p = s.p.data() + (std::size_t(s.kept) * n);
            for (int k = 0; k < n; ++k) q[k] = s.residual[k] - s.last_residual[k], p[k] = s.answer[k] - s.last_answer[k];
            const double whole = std::sqrt(inner(s, q, q));
            for (int j = 0; j < s.kept; ++j) {
                const double share = inner(s, s.q.data() + std::size_t(j) * n, q);
                subtract(q, share, s.q.data() + std::size_t(j) * n, n), subtract(p, share, s.p.data() + std::size_t(j) * n, n);
            }
            const double left = std::sqrt(inner(s, q, q));
            if (left > 1e-8 * whole) {
                for (int k = 0; k < n; ++k) q[k] /= left, p[k] /= left;
                ++s.kept;
            }
        }
        s.last_residual = s.residual, s.last_answer = s.answer, s.has_last = true;
        s.F = s.answer;
        for (int j = 0; j < s.kept; ++j) {
            const double share = inner(s, s.q.data() + std::size_t(j) * n, s.residual.data());
            subtract(s.residual.data(), share, s.q.data() + std::size_t(j) * n, n);
            subtract(s.F.data(), share, s.p.data() + std::size_t(j) * n, n);
        }
    }

    // Makes the step.
    void move(const String& s, const Part& part, const double* now) {
        using V = Simd;
        const auto& g = *part.given;
        const Component& c = components_[g.component];
        const double* forces = now + layout_.port[g.component];
        double *sx = x(part), *sy = y(part);
        std::copy(part.fx.begin(), part.fx.end(), sx);
        std::copy(part.fy.begin(), part.fy.end(), sy);
        for (int k = 0; k < g.n; ++k) {
            sx[k] += g.kick[k] * s.F[part.at + k];
            sy[k] += g.kick[g.width + k] * s.F[part.at + k];
        }
        for (int p = 0; p < c.n_ports; ++p) {
            const double f = forces[p], *w = c.w.data() + 2 * std::size_t(p) * c.n;
            for (int k = 0; k < c.n; k += V::width) {
                V::store(sx + k, V::load(sx + k) + V::load(w + k) * f);
                V::store(sy + k, V::load(sy + k) + V::load(w + c.n + k) * f);
            }
        }
    }

    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Geometric& geometric_;
    Statistics& statistics_;
    LawForces& laws_;
    GeneralStep general_;
    std::vector<String> strings_;
};

}  // namespace
}  // namespace tonewood
