// Time steps of the literature beside the project's own, compiled alike so that their times can be compared: every mode
// holds the two numbers of the kernel's state, all rules go through one loop, one pass over the modes per sample.
//
//     f = -(G r + K f_before)         forces of m rigid connections from the rows of the last pass
//     pass: modes move on under f; the rows of the new state are summed on the way
//
// A rule says how one mode moves. The level of the connections (positions, velocities or accelerations), where a force
// acts within a step and how it is continued from earlier ones is all in the arrays.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "../modal/simd.hpp"

namespace tonewood {

constexpr int kStateNumbers = 6;  // of a mode, at most: x, y and two past rates

struct MethodPart {
    int n = 0, n_links = 0, n_outs = 0;
    std::size_t offset = 0;
    Array<double> coef;   // (n_coef, n)
    Array<double> excite;   // (phases, n_links, lags, n_in, n)
    Array<double> reads;  // (n_links, n_row, n)
    Array<double> outs;   // (n_outs, n_out, n)
    std::vector<int> links, channels;
};

struct MethodPlan {
    int m = 0, phases = 1, lags = 1, n_channels = 0;
    Array<double> g_t;         // (phases, m, m), G transposed
    Array<double> memory_t;    // (phases, m, m), K transposed; empty if there is none
    Array<double> out_memory;  // (phases, n_channels, m) of the last forces in the readouts; empty if there is none
    double c[4] = {};      // constants of the rule
    std::vector<MethodPart> parts;
};

struct MethodJob {
    double* state[kStateNumbers];
    double* forces;  // (lags, m), latest first
    std::int64_t n, every;
    double* out;     // (n / every + 1, n_channels)
};

// Step at which something stopped being finite, -1 if nothing did.
using MethodRun = std::int64_t (*)(const MethodPlan&, MethodJob&);

enum MethodKind { kFlow, kAdamsBashforth, kVerlet, kNewmark, kMethodKinds };

struct ExplicitPlan;
// state, steps, every, out
using ExplicitRun = std::int64_t (*)(const ExplicitPlan&, double* const*, std::int64_t, std::int64_t, double*);

struct MethodTable {
    const char* name;
    MethodRun run[kMethodKinds];
    ExplicitRun run_explicit;  // see explicit_laws.hpp
};

namespace {

using MPack = Pack<2>;
static_assert(kPadding % MPack::size == 0);

// x+ = E x + P f: the exact flow of a mode, forces entering through any vectors.
struct Flow {
    static constexpr int n_state = 2, n_coef = 4, n_in = 2, n_row = 2, n_out = 2;
    MPack x, y;
    Flow(const double* const* s, const double* c, std::size_t n, std::size_t k, const double*) {
        const MPack a = MPack::load(s[0] + k), b = MPack::load(s[1] + k);
        x = mul_add(MPack::load(c + k), a, MPack::load(c + n + k) * b);
        y = mul_add(MPack::load(c + 3 * n + k), b, MPack::load(c + 2 * n + k) * a);
    }
    void excite(const double* v, std::size_t n, std::size_t k, double f) {
        x = mul_add(MPack::load(v + k), f, x);
        y = mul_add(MPack::load(v + n + k), f, y);
    }
    void finish(double* const* s, std::size_t k, const double*) { x.store(s[0] + k), y.store(s[1] + k); }
    MPack read(const double* r, std::size_t n, std::size_t k) const {
        return mul_add(MPack::load(r + k), x, MPack::load(r + n + k) * y);
    }
    MPack out(const double* r, std::size_t n, std::size_t k) const { return read(r, n, k); }
    static void rotate(double**) {}
};

// d = A x + B f,  x+ = x + c0 d + c1 d_-1 + c2 d_-2.
struct AdamsBashforth {
    static constexpr int n_state = 6, n_coef = 4, n_in = 2, n_row = 2, n_out = 2;
    MPack x, y, dx, dy;
    AdamsBashforth(const double* const* s, const double* c, std::size_t n, std::size_t k, const double*) {
        x = MPack::load(s[0] + k), y = MPack::load(s[1] + k);
        dx = mul_add(MPack::load(c + k), x, MPack::load(c + n + k) * y);
        dy = mul_add(MPack::load(c + 3 * n + k), y, MPack::load(c + 2 * n + k) * x);
    }
    void excite(const double* v, std::size_t n, std::size_t k, double f) {
        dx = mul_add(MPack::load(v + k), f, dx);
        dy = mul_add(MPack::load(v + n + k), f, dy);
    }
    void finish(double* const* s, std::size_t k, const double* c) {  // the oldest rate makes room for the new one
        x = mul_add(dx, c[0], mul_add(MPack::load(s[2] + k), c[1], mul_add(MPack::load(s[4] + k), c[2], x)));
        y = mul_add(dy, c[0], mul_add(MPack::load(s[3] + k), c[1], mul_add(MPack::load(s[5] + k), c[2], y)));
        x.store(s[0] + k), y.store(s[1] + k), dx.store(s[4] + k), dy.store(s[5] + k);
    }
    MPack read(const double* r, std::size_t n, std::size_t k) const {
        return mul_add(MPack::load(r + k), x, MPack::load(r + n + k) * y);
    }
    MPack out(const double* r, std::size_t n, std::size_t k) const { return read(r, n, k); }
    static void rotate(double** s) { std::swap(s[2], s[4]), std::swap(s[3], s[5]); }
};

// Real modes; state q, velocity half a step before, and the acceleration without connections, g = -w2 q - 2 sigma v:
// a = g + phi f,  w+ = w + h a,  q+ = q + h w+,  g+ = -w2 q+ - 2 sigma (w+ + h a / 2).
struct Verlet {
    static constexpr int n_state = 3, n_coef = 2, n_in = 1, n_row = 1, n_out = 1;
    MPack q, w, a, stiffness, damping;
    Verlet(const double* const* s, const double* c, std::size_t n, std::size_t k, const double*) {
        q = MPack::load(s[0] + k), w = MPack::load(s[1] + k), a = MPack::load(s[2] + k);
        stiffness = MPack::load(c + k), damping = MPack::load(c + n + k);
    }
    void excite(const double* v, std::size_t, std::size_t k, double f) { a = mul_add(MPack::load(v + k), f, a); }
    void finish(double* const* s, std::size_t k, const double* c) {
        w = mul_add(a, c[0], w);
        q = mul_add(w, c[0], q);
        a = neg_mul_add(stiffness, q, neg_mul_add(damping, mul_add(a, c[1], w), MPack{}));
        q.store(s[0] + k), w.store(s[1] + k), a.store(s[2] + k);
    }
    MPack read(const double* r, std::size_t, std::size_t k) const { return MPack::load(r + k) * a; }
    MPack out(const double* r, std::size_t, std::size_t k) const { return MPack::load(r + k) * q; }
    static void rotate(double**) {}
};

// Real modes; state u, v, a in units in which h = 1: a+ = cu u + cv v + ca a + p f,
// u+ = u + v + c0 a + c1 a+,  v+ = v + c2 a + c3 a+.
struct Newmark {
    static constexpr int n_state = 3, n_coef = 3, n_in = 1, n_row = 1, n_out = 1;
    MPack u, v, a, next, cu, cv, ca;
    Newmark(const double* const* s, const double* c, std::size_t n, std::size_t k, const double*) {
        u = MPack::load(s[0] + k), v = MPack::load(s[1] + k), a = MPack::load(s[2] + k);
        cu = MPack::load(c + k), cv = MPack::load(c + n + k), ca = MPack::load(c + 2 * n + k);
        next = mul_add(cu, u, mul_add(cv, v, ca * a));
    }
    void excite(const double* p, std::size_t, std::size_t k, double f) { next = mul_add(MPack::load(p + k), f, next); }
    void finish(double* const* s, std::size_t k, const double* c) {
        u = mul_add(next, c[1], mul_add(a, c[0], u + v));
        v = mul_add(next, c[3], mul_add(a, c[2], v));
        a = next;
        u.store(s[0] + k), v.store(s[1] + k), a.store(s[2] + k);
        next = mul_add(cu, u, mul_add(cv, v, ca * a));
    }
    MPack read(const double* r, std::size_t, std::size_t k) const { return MPack::load(r + k) * next; }
    MPack out(const double* r, std::size_t, std::size_t k) const { return MPack::load(r + k) * u; }
    static void rotate(double**) {}
};

inline double total(const MPack& p) { return Simd::sum(p.folded()); }

// One pass over a part's modes. `f` (n_links, lags) are its forces; rows of the new state go to `read` and `out`.
// Links and Outs are their numbers where those are small and known, else -1.
template <class Rule, int Links, int Outs>
void pass(const MethodPart& p, double* const* s, const double* f, int lags, int phase, const double* c, double* read,
          double* out, MPack* memory) {
    const std::size_t n = p.n;
    const int links = Links < 0 ? p.n_links : Links, outs = Outs < 0 ? p.n_outs : Outs;
    MPack fixed[Links < 0 ? 1 : Links + Outs + 1] = {};
    MPack* const acc = Links < 0 ? memory : fixed;
    if constexpr (Links < 0)
        for (int i = 0; i < links + outs; ++i) acc[i] = MPack{};
    const double* const excite = p.excite.data() + std::size_t(phase) * links * lags * Rule::n_in * n;
    double* state[kStateNumbers];
    for (int i = 0; i < Rule::n_state; ++i) state[i] = s[i] + p.offset;
    for (std::size_t k = 0; k < n; k += MPack::size) {
        Rule rule(state, p.coef.data(), n, k, c);
        const double* v = excite;
        for (int i = 0; i < links * lags; ++i, v += Rule::n_in * n) rule.excite(v, n, k, f[i]);
        rule.finish(state, k, c);
        for (int i = 0; i < links; ++i) acc[i] = acc[i] + rule.read(p.reads.data() + (i * Rule::n_row * n), n, k);
        for (int i = 0; i < outs; ++i)
            acc[links + i] = acc[links + i] + rule.out(p.outs.data() + (i * Rule::n_out * n), n, k);
    }
    for (int i = 0; i < links; ++i) read[i] = total(acc[i]);
    for (int i = 0; i < outs; ++i) out[i] = total(acc[links + i]);
}

template <class Rule, int Links>
auto choose_outs(int outs) {
    return outs == 0 ? &pass<Rule, Links, 0> : outs == 1 ? &pass<Rule, Links, 1> : &pass<Rule, -1, -1>;
}
template <class Rule>
auto choose(const MethodPart& p) {
    return p.n_links == 0   ? choose_outs<Rule, 0>(p.n_outs)
           : p.n_links == 1 ? choose_outs<Rule, 1>(p.n_outs)
           : p.n_links == 2 ? choose_outs<Rule, 2>(p.n_outs)
                            : &pass<Rule, -1, -1>;
}

// sum -= matrix x, the (m, m) matrix given transposed
inline void subtract_product(const double* transposed, const double* x, int m, double* sum) {
    for (int j = 0; j < m; ++j)
        for (int i = 0; i < m; ++i) sum[i] -= transposed[std::size_t(j) * m + i] * x[j];
}

struct NoDenormals {
#if defined(__x86_64__)
    unsigned saved = _mm_getcsr();
    NoDenormals() { _mm_setcsr(saved | 0x8040); }
    ~NoDenormals() { _mm_setcsr(saved); }
#endif
};

template <class Rule>
std::int64_t run_method(const MethodPlan& plan, MethodJob& job) {
    const NoDenormals no_denormals;
    const int m = plan.m, lags = plan.lags, n_parts = int(plan.parts.size()), channels = plan.n_channels;
    int widest = 0;
    std::vector<decltype(choose<Rule>(plan.parts[0]))> visits;
    for (const MethodPart& p : plan.parts) {
        visits.push_back(choose<Rule>(p));
        widest = std::max(widest, p.n_links + p.n_outs);
    }
    Array<double> r(m), sums(widest), outs(widest), f(std::size_t(widest) * lags), force(m);
    Array<MPack> memory(widest);
    double* state[kStateNumbers];
    for (int i = 0; i < kStateNumbers; ++i) state[i] = job.state[i];

    // rows of the state before the first step, without moving it
    const auto look = [&](double* to) {
        for (int i = 0; i < n_parts; ++i) {
            const MethodPart& p = plan.parts[i];
            for (int o = 0; o < p.n_outs; ++o)
                for (int d = 0; d < Rule::n_out; ++d)
                    for (int k = 0; k < p.n; ++k)
                        to[p.channels[o]] +=
                            p.outs[(std::size_t(o) * Rule::n_out + d) * p.n + k] * state[d][p.offset + k];
        }
    };
    for (int i = 0; i < channels; ++i) job.out[i] = 0.0;
    look(job.out);
    for (int i = 0; i < n_parts; ++i) {
        const MethodPart& p = plan.parts[i];
        for (int l = 0; l < p.n_links; ++l) {
            double sum = 0.0;
            for (int k = 0; k < p.n; ++k) {
                if constexpr (Rule::n_row == 2)
                    for (int d = 0; d < 2; ++d)
                        sum += p.reads[(std::size_t(l) * 2 + d) * p.n + k] * state[d][p.offset + k];
                else if constexpr (std::is_same_v<Rule, Verlet>)
                    sum += p.reads[std::size_t(l) * p.n + k] * state[2][p.offset + k];
                else
                    for (int d = 0; d < 3; ++d)
                        sum += p.reads[std::size_t(l) * p.n + k] * p.coef[std::size_t(d) * p.n + k] *
                               state[d][p.offset + k];
            }
            r[p.links[l]] += sum;
        }
    }

    double* to = job.out;
    std::int64_t until = job.every;
    for (std::int64_t step = 0; step < job.n; ++step) {
        const int phase = int(step % plan.phases);
        const std::size_t at = std::size_t(phase) * m * m;
        std::fill(force.begin(), force.end(), 0.0);
        subtract_product(plan.g_t.data() + at, r.data(), m, force.data());
        if (!plan.memory_t.empty()) subtract_product(plan.memory_t.data() + at, job.forces, m, force.data());
        for (int lag = lags - 1; lag > 0; --lag)
            for (int i = 0; i < m; ++i) job.forces[lag * m + i] = job.forces[(lag - 1) * m + i];
        for (int i = 0; i < m; ++i) job.forces[i] = force[i], r[i] = 0.0;
        const bool write = --until == 0;
        if (write) {
            to += channels, until = job.every;
            for (int i = 0; i < channels; ++i) to[i] = 0.0;
        }
        for (int i = 0; i < n_parts; ++i) {
            const MethodPart& p = plan.parts[i];
            for (int l = 0; l < p.n_links; ++l)
                for (int lag = 0; lag < lags; ++lag) f[l * lags + lag] = job.forces[lag * m + p.links[l]];
            visits[i](p, state, f.data(), lags, phase, plan.c, sums.data(), outs.data(), memory.data());
            for (int l = 0; l < p.n_links; ++l) r[p.links[l]] += sums[l];
            if (write)
                for (int o = 0; o < p.n_outs; ++o) to[p.channels[o]] += outs[o];
        }
        if (write && !plan.out_memory.empty()) {
            const double* w = plan.out_memory.data() + std::size_t(phase) * channels * m;
            for (int o = 0; o < channels; ++o)
                for (int j = 0; j < m; ++j) to[o] += w[std::size_t(o) * m + j] * force[j];
        }
        Rule::rotate(state);
        if ((step & 63) == 63 || step + 1 == job.n) {
            double check = 0.0;
            for (int i = 0; i < m; ++i) check += r[i] + force[i];
            if (!std::isfinite(check)) return step;
        }
    }
    // past rates go back to where the caller expects them
    if (state[2] != job.state[2])
        for (int i = 2; i < 4; ++i)
            for (const MethodPart& p : plan.parts)
                for (int k = 0; k < p.n; ++k) std::swap(job.state[i][p.offset + k], job.state[i + 2][p.offset + k]);
    return -1;
}

}  // namespace
}  // namespace tonewood
