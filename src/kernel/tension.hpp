// Strings whose tension rises with amplitude, sample by sample; the equations are in tonewood.numerics.tension.
//
// Given the tensions T of a step the system is linear, with other compliances. One pass over a string's modes finds,
// with u = y_free + y, U = u / (1 + w a T / 2), C_p = w phi_p / (1 + w a T / 2),
//     port displacement  sum phi_p U + sum_q (sum phi_p C_q) f_q - its old value,
//     S+ = S + sum a U (U - 2 y) + sum_p f_p 2 sum a C_p (U - y) + sum_pq f_p f_q sum a C_p C_q,
// so that the forces and the new S come out of small sums; Newton's method on T - kappa (S+ + S) goes over the modes
// once per iteration.
#pragma once

#include <algorithm>
#include <cmath>

#include "lines.hpp"
#include "nonlinear.hpp"

namespace tonewood {
namespace {

template <class T>
constexpr double kTensionTolerance = sizeof(T) == sizeof(double) ? 1e-11 : 1e-5;  // of the tension
template <class T>
constexpr double kForceTolerance = sizeof(T) == sizeof(double) ? 1e-14 : 1e-7;  // of the largest force
constexpr int kMaxTensionIterations = 200;

// Sums of one pass over the modes of a component, with P ports (P < 0: any number): S part, slope, then A and Q by
// port, then Z and R by pair p <= q.
// `yields` (n) keeps 1 / (1 + w a T / 2) from pass to pass: `corrections` of Newton's steps bring it up to the tension,
// 0 divides anew.
template <class T, int P>
void stretch_pass(const Component<T>& c, const T* u, const T* y, T* kept, double tension, int corrections,
                  const double* f, double* sums) {
    using S = Simd<T>;
    using V = typename S::V;
    const int n_ports = P < 0 ? c.n_ports : P;
    const std::size_t n = c.n;
    // in locals: what is stored below could otherwise be taken for them
    const T *const weights = c.stretched.a.data(), *const halves = c.stretched.half.data();
    const T *const phis = c.stretched.phi.data(), *const per_force = c.stretched.c.data();
    constexpr int kMost = P < 0 ? kMaxStretchedPorts : (P > 0 ? P : 1);
    constexpr int kPairs = kMost * (kMost + 1) / 2;
    V part{}, slope{}, A[kMost] = {}, Q[kMost] = {}, Z[kPairs] = {}, R[kPairs] = {};
    const T t = T(tension);
    T force[kMost] = {};
    for (int p = 0; p < n_ports; ++p) force[p] = T(f[p]);
    if (corrections == 0) {
        for (std::size_t k = 0; k < n; k += S::width) S::store(kept + k, T(1) / (T(1) + S::load(halves + k) * t));
    } else {
        for (std::size_t k = 0; k < n; k += S::width) {
            const V stiff = T(1) + S::load(halves + k) * t;
            V yields = S::load(kept + k);
            for (int step = 0; step < corrections; ++step) yields *= T(2) - stiff * yields;
            S::store(kept + k, yields);
        }
    }
    for (std::size_t k = 0; k < n; k += S::width) {
        const V a = S::load(weights + k), half = S::load(halves + k), here = S::load(y + k), both = S::load(u + k);
        const V yields = S::load(kept + k);
        const V U = both * yields;
        V C[kMost], D = U;
        for (int p = 0; p < n_ports; ++p) {
            C[p] = S::load(per_force + p * n + k) * yields;
            D += C[p] * force[p];
        }
        const V aU = a * U;
        part += aU * (U - here - here);
        slope += a * half * yields * D * (D - here);
        int pair = 0;
        for (int p = 0; p < n_ports; ++p) {
            const V phi = S::load(phis + p * n + k), aC = a * C[p];
            A[p] += phi * U;
            Q[p] += aC * (U - here);
            for (int q = p; q < n_ports; ++q, ++pair) {
                Z[pair] += phi * C[q];
                R[pair] += aC * C[q];
            }
        }
    }
    const auto sum = [](V v) { return S::sum(v); };
    *sums++ = sum(part), *sums++ = -2 * sum(slope);
    for (int p = 0; p < n_ports; ++p) *sums++ = sum(A[p]), *sums++ = 2 * sum(Q[p]);
    for (int pair = 0; pair < n_ports * (n_ports + 1) / 2; ++pair) *sums++ = sum(Z[pair]), *sums++ = sum(R[pair]);
}

template <class T>
class TensionStep {
    friend class TenseContacts<T>;

public:
    TensionStep(const std::vector<Component<T>>& components, const Layout& layout, const Solve& solve,
                const Tensions& tensions, TensionSpace& space, Statistics& statistics, const Job<T>& job)
        : components_(components), layout_(layout), solve_(solve), tensions_(tensions), ws_(space),
          statistics_(statistics), job_(job), pushed_(components.size()) {
        for (const int i : tensions_.components) pushed_[i].reserve(components[i].guarded.n);
    }

    // Sample b of a block: rows of the stretched components, tensions, forces of the linear connections in f, port
    // forces in now; moves the stretched components. False if the tensions were not found.
    bool step(int b, double* lines, const std::vector<std::vector<Input<T>>>& known, double* f, double* now) {
        begin_sample(b, lines, known);
        if (!linear_step(b, f, now)) return false;
        finish_sample(b, known, now);
        return true;
    }

    // Rows of the stretched components at the end of a block.
    void finish_block(int nb, double* lines) {
        for (const int i : tensions_.components) rows(i, nb, lines);
    }

private:
    T* x(int i) const { return job_.modes[0] + components_[i].offset; }
    T* y(int i) const { return job_.modes[1] + components_[i].offset; }

    // Coordinates of the stretched components, and where to start.
    void begin_sample(int b, double* lines, const std::vector<std::vector<Input<T>>>& known) {
        for (const int i : tensions_.components) {
            begin(i, b, lines, known[i]);
            if (b == 0) ws_.kept_at[i] = INFINITY;  // a block depends on nothing but the state it begins with
        }
        const double* last = job_.tension;
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            double stretch = 0.0;
            for (const int i : tensions_.strings[s].components) stretch += ws_.stretch[i];
            ws_.old_stretch[s] = stretch;
            const double* t = last + 3 * tensions_.strings[s].index;
            // three last means, going on as a parabola
            ws_.tension[s] = std::max(3 * t[0] - 3 * t[1] + t[2], tensions_.strings[s].kappa * stretch);
        }
        gaps_at_start(b, lines);
    }

    // Tensions and forces where only linear connections act.
    bool linear_step(int b, double* f, double* now) {
        int iterations = 0;
        bool done = false;
        while (!done && iterations++ < kMaxTensionIterations) {
            for (int s = 0; s < int(tensions_.strings.size()); ++s)
                for (const int i : tensions_.strings[s].components) pass(i, ws_.tension[s]);
            if (!linear_forces(b, iterations, f)) break;
            std::fill_n(now, layout_.force_width, 0.0);
            add_product(layout_.push.data(), layout_.force_width, f, solve_.m, now);
            done = correct(iterations, [&](int i, double& after, double& slope, double& size) {
                gain(i, now + layout_.port[i], after, slope, size);
            });
            for (const int i : tensions_.components)
                std::copy_n(now + layout_.port[i], components_[i].n_ports, ws_.guess[i].data());
        }
        book(iterations, done);
        return done;
    }

    void book(int iterations, bool done) {
        statistics_.tension_iterations += iterations;
        statistics_.most_tension_iterations = std::max<std::int64_t>(statistics_.most_tension_iterations, iterations);
        statistics_.failures += !done;
    }

    // Newton's step of every tension; true if they were right already. `gain_of` adds what a component's stretch gains.
    template <class Gain>
    bool correct(int iteration, const Gain& gain_of) {
        bool found = true;
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            const auto& string = tensions_.strings[s];
            double after = ws_.old_stretch[s], slope = 0.0, size = after;
            for (const int i : string.components) gain_of(i, after, slope, size);
            const double excess = ws_.tension[s] - string.kappa * (after + ws_.old_stretch[s]);
            ws_.used[s] = ws_.tension[s];
            if (!(std::abs(excess) <= kTensionTolerance<T> * (ws_.tension[s] + 1e-2 * string.kappa * size))) found = false;
            // the slope at constant forces first, then the secant, which knows how the forces answer
            double steepness = 1 - string.kappa * slope;
            if (iteration > 1) {
                const double secant = (excess - ws_.last_excess[s]) / (ws_.tension[s] - ws_.last_tension[s]);
                if (secant > 0.5 * steepness && secant < 2 * steepness) steepness = secant;
            }
            ws_.last_excess[s] = excess, ws_.last_tension[s] = ws_.tension[s];
            ws_.tension[s] = std::max(string.kappa * ws_.old_stretch[s], ws_.tension[s] - excess / steepness);
        }
        return found;
    }

    // Moves the stretched components, the port forces known.
    void finish_sample(int b, const std::vector<std::vector<Input<T>>>& known, const double* now) {
        double* last = job_.tension;
        for (int s = 0; s < int(tensions_.strings.size()); ++s) {
            double* t = last + 3 * tensions_.strings[s].index;
            t[2] = t[1], t[1] = t[0], t[0] = ws_.used[s];
            for (const int i : tensions_.strings[s].components) move(i, b, known[i], ws_.used[s], now + layout_.port[i]);
        }
    }

    void rows(int i, int b, double* lines) {
        using S = Simd<T>;
        const Component<T>& c = components_[i];
        double* line = lines + std::size_t(b) * layout_.width + layout_.row[i];
        const T *sx = x(i), *sy = y(i);
        for (int r = 0; r < c.n_rows; ++r) {
            const T *rx = &c.rows[2 * std::size_t(r) * c.n], *ry = rx + c.n;
            typename S::V sum{}, more{};
            if (r < c.n_ports) {  // a displacement of real modes: of the first number alone
                for (int k = 0; k < c.n; k += S::width) sum += S::load(rx + k) * S::load(sx + k);
            } else {
                for (int k = 0; k < c.n; k += S::width) {
                    sum += S::load(rx + k) * S::load(sx + k);
                    more += S::load(ry + k) * S::load(sy + k);
                }
            }
            line[r] = S::sum(sum + more);
        }
    }

    // Coordinates before the step and after it without forces, in ws.y and ws.u (their sum).
    void begin(int i, int b, double* lines, const std::vector<Input<T>>& known) {
        using S = Simd<T>;
        using V = typename S::V;
        const Component<T>& c = components_[i];
        rows(i, b, lines);
        const int n = c.n;
        const T *const sx = x(i), *const sy = y(i), *const readings = c.stretched.reading.data();
        const T *const e00 = c.e.data(), *const e01 = e00 + n, *const weights = c.stretched.a.data();
        T *const here = buffer(ws_.y, i), *const both = buffer(ws_.u, i);
        const Input<T>* const inputs = known.data();
        const int n_inputs = int(known.size());
        V stretch{};
        for (int k = 0; k < n; k += S::width) {
            const V a = S::load(sx + k), d = S::load(sy + k), reading = S::load(readings + k);
            V free = S::load(e00 + k) * a + S::load(e01 + k) * d;
            for (int j = 0; j < n_inputs; ++j)
                free += S::load(inputs[j].vector + k) * T(inputs[j].values[b * inputs[j].stride]);
            const V q = reading * a;
            S::store(here + k, q);
            S::store(both + k, q + reading * free);
            stretch += S::load(weights + k) * q * q;
        }
        ws_.stretch[i] = S::sum(stretch);
    }

    void pass(int i, double tension) {
        const Component<T>& c = components_[i];
        const T *u = buffer(ws_.u, i), *here = buffer(ws_.y, i);
        T* kept = buffer(ws_.yields, i);
        double *f = ws_.guess[i].data(), *sums = ws_.sums[i].data();
        // relative error of what is kept: each correction squares it
        const double far = std::abs(tension - ws_.kept_at[i]) * c.stretched.most_half;
        const int corrections = far < 1e-4 ? 2 : far < 1e-2 ? 3 : 0;
        ws_.kept_at[i] = tension;
        switch (c.n_ports) {
            case 0: stretch_pass<T, 0>(c, u, here, kept, tension, corrections, f, sums); break;
            case 1: stretch_pass<T, 1>(c, u, here, kept, tension, corrections, f, sums); break;
            case 2: stretch_pass<T, 2>(c, u, here, kept, tension, corrections, f, sums); break;
            default: stretch_pass<T, -1>(c, u, here, kept, tension, corrections, f, sums);
        }
    }

    // Adds what a component's stretch gains under port forces f, its slope with the tension, and the size of the terms.
    void gain(int i, const double* f, double& after, double& slope, double& size) const {
        const int n = components_[i].n_ports;
        const double* sums = ws_.sums[i].data();
        const auto add = [&](double term) { after += term, size += std::abs(term); };
        slope += sums[1];
        add(sums[0]);
        for (int p = 0; p < n; ++p) add(f[p] * sums[3 + 2 * p]);
        const double* pair = sums + 2 + 2 * n;
        for (int p = 0; p < n; ++p)
            for (int q = p; q < n; ++q, pair += 2) add((p == q ? 1.0 : 2.0) * f[p] * f[q] * pair[1]);
    }

    // The part of the gaps that the tensions do not change, gamma g - offset.
    void gaps_at_start(int b, const double* lines) {
        std::fill(ws_.fixed.begin(), ws_.fixed.end(), 0.0);
        const double* line = lines + std::size_t(b) * layout_.width;
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

    // f = -M(T)^-1 (g_free + gamma g - offset): by an inverse that is a few samples old, and corrections with M itself.
    bool linear_forces(int b, int iteration, double* f) {
        const int m = solve_.m;
        double *M = ws_.matrix.data(), *v = ws_.right.data();
        std::copy(tensions_.matrix.begin(), tensions_.matrix.end(), M);
        std::copy(ws_.fixed.begin(), ws_.fixed.end(), v);
        for (const auto& t : tensions_.terms) {
            if (!components_[t.component].stretched.on) continue;
            v[t.connection] += t.factor * ws_.sums[t.component][2 + 2 * t.port];
        }
        for (const auto& pair : tensions_.pairs) {
            const double* sums = ws_.sums[pair.component].data();
            const double moved = sums[2 + 2 * components_[pair.component].n_ports + 2 * pair.place];
            M[pair.row * m + pair.column] += pair.factor * (moved - pair.rest);
        }
        std::fill_n(f, layout_.f_width, 0.0);
        return solve_linear(M, v, f, b == 0 && iteration == 1);
    }

    // In two chains, as many as pay for the few connections of a string.
    static double dot(const double* a, const double* b, int n) {
        using S = Simd<double>;
        S::V sums{};
        int j = 0;
        for (; j + S::width <= n; j += S::width) sums += S::load(a + j) * S::load(b + j);
        double rest = 0.0;
        for (; j < n; ++j) rest += a[j] * b[j];
        return n < S::width ? rest : S::sum(sums) + rest;
    }

    // f = -M^-1 v; `fresh` makes the inverse anew, `warm` starts from the last solution.
    bool solve_linear(const double* M, const double* v, double* f, bool fresh, bool warm = true) {
        const int m = solve_.m;
        double *now = ws_.solution.data(), *wrong = ws_.wrong.data();
        if (fresh) invert(M);
        for (int attempt = 0; attempt < 2; ++attempt) {
            if (fresh || !warm || attempt > 0) std::fill_n(now, m, 0.0);
            for (int correction = 0; correction < 12; ++correction) {
                double change = 0.0, size = 0.0;
                for (int i = 0; i < m; ++i) {
                    wrong[i] = -v[i] - dot(M + std::size_t(i) * m, now, m);
                }
                for (int i = 0; i < m; ++i) {
                    const double sum = dot(&ws_.inverse[std::size_t(i) * m], wrong, m);
                    now[i] += sum;
                    change = std::max(change, std::abs(sum) * ws_.scale[i]);
                    size = std::max(size, std::abs(now[i]) * ws_.scale[i]);
                }
                if (change <= kForceTolerance<T> * size) {
                    std::copy_n(now, m, f);
                    return true;
                }
            }
            // the tension has gone too far from where the inverse was made
            if (!fresh && attempt == 0) fresh = true, invert(M);
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

    // The step itself, the tension and the port forces known.
    void move(int i, int b, const std::vector<Input<T>>& known, double tension, const double* f) {
        using S = Simd<T>;
        using V = typename S::V;
        const Component<T>& c = components_[i];
        const std::size_t n = c.n;
        T *const sx = x(i), *const sy = y(i);
        const T *const u = buffer(ws_.u, i), *const yields = buffer(ws_.yields, i);
        const T *const e = c.e.data(), *const weights = c.stretched.a.data(), *const kick = c.stretched.kick.data();
        const T *const per_force = c.stretched.c.data(), *const w = c.w.data();
        const Input<T>* const inputs = known.data();
        const Pushed* const pushed = pushed_[i].data();
        const int n_ports = c.n_ports, n_inputs = int(known.size()), n_pushed = int(pushed_[i].size());
        T force[kMaxStretchedPorts];
        for (int p = 0; p < n_ports; ++p) force[p] = T(f[p]);
        const T half_t = T(-0.5 * tension);
        for (std::size_t k = 0; k < n; k += S::width) {
            V D = S::load(u + k);
            const V a = S::load(sx + k), d = S::load(sy + k);
            V nx = S::load(e + k) * a + S::load(e + n + k) * d;
            V ny = S::load(e + 2 * n + k) * a + S::load(e + 3 * n + k) * d;
            for (int j = 0; j < n_inputs; ++j) {
                const T value = T(inputs[j].values[b * inputs[j].stride]);
                nx += S::load(inputs[j].vector + k) * value, ny += S::load(inputs[j].vector + n + k) * value;
            }
            for (int p = 0; p < n_ports; ++p) {
                D += S::load(per_force + p * n + k) * force[p];
                nx += S::load(w + 2 * p * n + k) * force[p], ny += S::load(w + (2 * p + 1) * n + k) * force[p];
            }
            for (int j = 0; j < n_pushed; ++j) {
                D += S::load(pushed[j].per_force + k) * pushed[j].force;
                nx += S::load(pushed[j].w + k) * pushed[j].force, ny += S::load(pushed[j].w + n + k) * pushed[j].force;
            }
            const V pull = S::load(weights + k) * D * S::load(yields + k) * half_t;
            S::store(sx + k, nx + S::load(kick + k) * pull);
            S::store(sy + k, ny + S::load(kick + n + k) * pull);
        }
    }

    T* buffer(Array<char>& bytes, int i) const { return reinterpret_cast<T*>(bytes.data()) + components_[i].offset; }

    const std::vector<Component<T>>& components_;
    const Layout& layout_;
    const Solve& solve_;
    const Tensions& tensions_;
    TensionSpace& ws_;
    Statistics& statistics_;
    const Job<T>& job_;
    // forces on guarded ports, by component
    struct Pushed {
        const T *per_force, *w;
        T force;
    };
    std::vector<std::vector<Pushed>> pushed_;
};

}  // namespace
}  // namespace tonewood
