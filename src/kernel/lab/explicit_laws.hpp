// Velocity Verlet for strings whose tension rises and for laws between components, real modes: an explicit method for
// the systems that the kernel solves implicitly. The loop is that of methods.hpp.
//
//     a = g - (EA/2L) S k q + phi f,   w+ = w + h a,   q+ = q + h w+,   g+ = -w2 q+ - 2 sigma (w+ + h a / 2)
//
// with S = sum k q^2 of the string. Laws are evaluated at the gap and its rate, rigid connections solved on the level
// of accelerations, forces of laws included.
#pragma once

#include "methods.hpp"

namespace tonewood {

struct ExplicitLaw {
    bool one_sided;      // K <p>^alpha (1 + loss p'), else k p + k3 p^3 + c p' + d p' |p'|
    double a[4];         // K, alpha, loss; or k, k3, c, d
    double offset;       // p = offset - gap
};

struct ExplicitPart {
    int n = 0, n_rigid = 0, n_laws = 0, n_outs = 0, tension = -1;
    std::size_t offset = 0;
    Array<double> coef;              // (3, n): w2, 2 sigma, k
    Array<double> rigid, law, outs;  // (., n) shapes
    std::vector<int> rigid_links, law_links, channels;
};

struct ExplicitPlan {
    double h = 0.0;
    int n_rigid = 0, n_channels = 0;
    Array<double> g_t, exchange;     // (r, r) transposed; (r, l) rigid gaps' acceleration per force of a law
    std::vector<ExplicitLaw> laws;
    std::vector<double> stiffness;   // EA/2L of every tension
    std::vector<ExplicitPart> parts;
};

namespace {

inline double force_of(const ExplicitLaw& law, double gap, double rate) {
    const double p = law.offset - gap, v = -rate;
    if (!law.one_sided) return law.a[0] * p + law.a[1] * p * p * p + (law.a[2] + law.a[3] * std::abs(v)) * v;
    return p > 0 ? law.a[0] * std::pow(p, law.a[1]) * (1 + law.a[2] * v) : 0.0;
}

// Sums of a modal pass: accelerations and k q at rigid gaps, displacements and rates at laws, readouts, S.
struct ExplicitSums {
    double *acceleration, *stretch, *gap, *rate, *out, *S;
};

template <bool Move>
void explicit_pass(const ExplicitPart& p, double* const* state, double h, double tension, const double* rigid_force,
                   const double* law_force, const ExplicitSums& to, MPack* acc) {
    const std::size_t n = p.n;
    double *const sq = state[0] + p.offset, *const sw = state[1] + p.offset, *const sg = state[2] + p.offset;
    const double *const w2 = p.coef.data(), *const loss = w2 + n, *const k2 = loss + n;
    const int n_acc = 2 * p.n_rigid + 2 * p.n_laws + p.n_outs + 1;
    for (int i = 0; i < n_acc; ++i) acc[i] = MPack{};
    for (std::size_t k = 0; k < n; k += MPack::size) {
        MPack q = MPack::load(sq + k), w = MPack::load(sw + k), a = MPack::load(sg + k), v = w, g = a;
        const MPack weight = MPack::load(k2 + k);
        if constexpr (Move) {
            a = mul_add(weight * q, -tension, a);
            for (int i = 0; i < p.n_rigid; ++i) a = mul_add(MPack::load(p.rigid.data() + i * n + k), rigid_force[i], a);
            for (int i = 0; i < p.n_laws; ++i) a = mul_add(MPack::load(p.law.data() + i * n + k), law_force[i], a);
            w = mul_add(a, h, w);
            q = mul_add(w, h, q);
            v = mul_add(a, 0.5 * h, w);
            g = neg_mul_add(MPack::load(w2 + k), q, neg_mul_add(MPack::load(loss + k), v, MPack{}));
            q.store(sq + k), w.store(sw + k), g.store(sg + k);
        }
        MPack* s = acc;
        const MPack stretched = weight * q;
        for (int i = 0; i < p.n_rigid; ++i, s += 2) {
            const MPack phi = MPack::load(p.rigid.data() + i * n + k);
            s[0] = mul_add(phi, g, s[0]), s[1] = mul_add(phi, stretched, s[1]);
        }
        for (int i = 0; i < p.n_laws; ++i, s += 2) {
            const MPack phi = MPack::load(p.law.data() + i * n + k);
            s[0] = mul_add(phi, q, s[0]), s[1] = mul_add(phi, v, s[1]);
        }
        for (int i = 0; i < p.n_outs; ++i, ++s) *s = mul_add(MPack::load(p.outs.data() + i * n + k), q, *s);
        *s = mul_add(stretched, q, *s);
    }
    const MPack* s = acc;
    for (int i = 0; i < p.n_rigid; ++i, s += 2) to.acceleration[i] = total(s[0]), to.stretch[i] = total(s[1]);
    for (int i = 0; i < p.n_laws; ++i, s += 2) to.gap[i] = total(s[0]), to.rate[i] = total(s[1]);
    for (int i = 0; i < p.n_outs; ++i, ++s) to.out[i] = total(*s);
    *to.S = total(*s);
}

inline std::int64_t run_explicit(const ExplicitPlan& plan, double* const* state, std::int64_t n, std::int64_t every,
                                 double* out) {
    const NoDenormals no_denormals;
    const int r = plan.n_rigid, l = int(plan.laws.size()), tensions = int(plan.stiffness.size());
    const int n_parts = int(plan.parts.size());
    int widest = 1;
    for (const ExplicitPart& p : plan.parts) widest = std::max(widest, 2 * (p.n_rigid + p.n_laws) + p.n_outs + 1);
    Array<MPack> acc(widest);
    // sums of every part, one after another
    Array<double> sums(std::size_t(n_parts) * 5 * widest), gap(l), rate(l), acceleration(r), f_law(l), f_rigid(r);
    Array<double> S(tensions), here_rigid(widest), here_law(widest);
    const auto sums_of = [&](int i) {
        double* at = sums.data() + std::size_t(i) * 5 * widest;
        return ExplicitSums{at, at + widest, at + 2 * widest, at + 3 * widest, at + 4 * widest, at + 5 * widest - 1};
    };
    const auto emit = [&](double* to) {
        for (int c = 0; c < plan.n_channels; ++c) to[c] = 0.0;
        for (int i = 0; i < n_parts; ++i)
            for (int o = 0; o < plan.parts[i].n_outs; ++o) to[plan.parts[i].channels[o]] += sums_of(i).out[o];
    };
    for (int i = 0; i < n_parts; ++i)
        explicit_pass<false>(plan.parts[i], state, plan.h, 0.0, nullptr, nullptr, sums_of(i), acc.data());
    emit(out);
    std::int64_t until = every;
    for (std::int64_t step = 0; step < n; ++step) {
        std::fill(S.begin(), S.end(), 0.0), std::fill(gap.begin(), gap.end(), 0.0);
        std::fill(rate.begin(), rate.end(), 0.0);
        for (int i = 0; i < n_parts; ++i) {
            const ExplicitPart& p = plan.parts[i];
            const ExplicitSums s = sums_of(i);
            if (p.tension >= 0) S[p.tension] += *s.S;
            for (int j = 0; j < p.n_laws; ++j) gap[p.law_links[j]] += s.gap[j], rate[p.law_links[j]] += s.rate[j];
        }
        for (int j = 0; j < l; ++j) f_law[j] = force_of(plan.laws[j], gap[j], rate[j]);
        for (int i = 0; i < r; ++i) {
            acceleration[i] = 0.0;
            for (int j = 0; j < l; ++j) acceleration[i] += plan.exchange[std::size_t(i) * l + j] * f_law[j];
        }
        for (int i = 0; i < n_parts; ++i) {
            const ExplicitPart& p = plan.parts[i];
            const ExplicitSums s = sums_of(i);
            const double tension = p.tension < 0 ? 0.0 : plan.stiffness[p.tension] * S[p.tension];
            for (int j = 0; j < p.n_rigid; ++j)
                acceleration[p.rigid_links[j]] += s.acceleration[j] - tension * s.stretch[j];
        }
        std::fill(f_rigid.begin(), f_rigid.end(), 0.0);
        subtract_product(plan.g_t.data(), acceleration.data(), r, f_rigid.data());
        double check = 0.0;
        for (int i = 0; i < n_parts; ++i) {
            const ExplicitPart& p = plan.parts[i];
            const double tension = p.tension < 0 ? 0.0 : plan.stiffness[p.tension] * S[p.tension];
            for (int j = 0; j < p.n_rigid; ++j) here_rigid[j] = f_rigid[p.rigid_links[j]];
            for (int j = 0; j < p.n_laws; ++j) here_law[j] = f_law[p.law_links[j]];
            explicit_pass<true>(p, state, plan.h, tension, here_rigid.data(), here_law.data(), sums_of(i), acc.data());
            check += *sums_of(i).S;
            for (int j = 0; j < p.n_rigid; ++j) check += sums_of(i).acceleration[j];
            for (int j = 0; j < p.n_laws; ++j) check += sums_of(i).gap[j];
        }
        if (--until == 0) out += plan.n_channels, until = every, emit(out);
        if (!std::isfinite(check)) return step;
    }
    return -1;
}

}  // namespace
}  // namespace tonewood
