// Nonlinear laws over one step; the formulas and their reasons are in tonewood.physics.coupling.laws.
#pragma once

#include <algorithm>
#include <cmath>

#include "../data/state.hpp"

namespace tonewood {
namespace {

struct LawForce {
    double force, slope;  // N; N/m with the new compression
};

constexpr double kClose = 1e-4;  // relative step below which slopes of discrete gradients are those at the middle

inline LawForce contact_force(const Law& law, double now, double old, double dt) {
    const double high = now > old ? now : old, low = now > old ? old : now;
    if (high <= 0.0) return {0.0, 0.0};
    const double K = law.a[0], n = law.a[1], step = high - low;
    const double at_high = K * (n == 1.0 ? high : std::pow(high, n));
    double gradient = at_high, slope;
    if (low <= 0.0)
        gradient = at_high * high / ((n + 1) * step);
    else if (n == 1.0)
        gradient = 0.5 * K * (high + low);
    else if (step > high * 0.999)
        gradient = (at_high * high - K * std::pow(low, n + 1)) / ((n + 1) * step);
    else if (step > 0.0) {
        const double ratio = step / low;
        gradient = K / (n + 1) * std::pow(low, n) * std::expm1((n + 1) * std::log1p(ratio)) / ratio;
    }
    const double at_now = now == high ? at_high : now > 0.0 ? K * std::pow(now, n) : 0.0;
    if (step < kClose * high)
        slope = 0.5 * K * n * std::pow(std::max(0.5 * (high + low), 0.0), n - 1);
    else
        slope = std::max((at_now - gradient) / (now - old), 0.0);
    return {gradient * (1 + law.loss * (now - old) / dt), slope + law.loss * at_now / dt};
}

inline LawForce spring_force(const Law& law, double now, double old, double dt) {
    const double k = law.a[0], k3 = law.a[1], d = law.a[2];
    const double total = now + old, squares = now * now + old * old, rate = (now - old) / dt;
    const double f = total * (0.5 * k + 0.25 * k3 * squares) + (law.damping + d * std::abs(rate)) * rate;
    const double slope = 0.5 * k + 0.25 * k3 * (squares + 2 * now * total);
    return {f, slope + (law.damping + 2 * d * std::abs(rate)) / dt};
}

struct Curvature {
    double slope, bend;  // V', V''
};

inline int cell(const Law& law, double d) {
    const int n = int(law.knots.size()) - 1;
    const int i = int(std::upper_bound(law.knots.begin(), law.knots.end(), d) - law.knots.begin()) - 1;
    return std::clamp(i, 0, n - 1);
}

inline Curvature sampled_at(const Law& law, double d) {
    const double* c = law.coefficients.data() + (4 * std::size_t(cell(law, d)));
    const double inside = std::clamp(d, law.knots.front(), law.knots.back());
    const double u = inside - law.knots[cell(law, d)], bend = 2 * c[2] + 6 * c[3] * u;
    return {c[1] + u * (2 * c[2] + 3 * c[3] * u) + bend * (d - inside), bend};
}

// V(b) - V(a) for a <= b, piece by piece by divided differences
inline double gained(const Law& law, double a, double b) {
    const double first = law.knots.front(), last = law.knots.back();
    double total = 0.0;
    const auto beyond = [&](double low, double high, double edge) {
        if (low >= high) return;
        const Curvature at = sampled_at(law, edge);
        total += (high - low) * (at.slope + 0.5 * at.bend * ((low - edge) + (high - edge)));
    };
    beyond(a, std::min(b, first), first);
    beyond(std::max(a, last), b, last);
    a = std::max(a, first), b = std::min(b, last);
    for (int i = cell(law, a); a < b; ++i) {
        const double* c = law.coefficients.data() + 4 * std::size_t(i);
        const double end = std::min(b, law.knots[i + 1]), u = a - law.knots[i], v = end - law.knots[i];
        total += (end - a) * (c[1] + c[2] * (u + v) + c[3] * (u * u + u * v + v * v));
        a = end;
    }
    return total;
}

inline LawForce sampled_force(const Law& law, double now, double old, double dt) {
    const double low = std::min(-now, -old), high = std::max(-now, -old), step = now - old;
    const double at_now = sampled_at(law, -now).slope;
    const double gradient = high > low ? -gained(law, low, high) / (high - low) : -at_now;
    const double slope = high - low <= kClose * std::max(std::abs(low), std::abs(high))
                             ? 0.5 * sampled_at(law, 0.5 * (low + high)).bend
                             : std::max((-at_now - gradient) / step, 0.0);
    return {gradient + (law.loss * std::abs(gradient) + law.damping) * (step / dt),
            slope + (law.loss * std::abs(at_now) + law.damping) / dt};
}

inline LawForce compiled_force(const Law& law, double now, double old, double dt) {
    // Gauss' rule of five points
    constexpr double node[5] = {-0.906179845938664, -0.5384693101056831, 0.0, 0.5384693101056831, 0.906179845938664};
    constexpr double weight[5] = {0.23692688505618908, 0.47862867049936647, 0.5688888888888889, 0.47862867049936647,
                                  0.23692688505618908};
    const double step = now - old, middle = 0.5 * (now + old), size = std::max(std::abs(now), std::abs(old));
    double gradient = 0.0;
    for (int i = 0; i < 5; ++i) gradient -= 0.5 * weight[i] * law.slope(-(middle + 0.5 * step * node[i]));
    if (step != 0.0) {
        const double v_now = law.potential(-now), v_old = law.potential(-old), quotient = (v_now - v_old) / step;
        if (std::abs(quotient - gradient) > 2e-15 * (std::abs(v_now) + std::abs(v_old)) / std::abs(step))
            gradient = quotient;
    }
    const double at_now = -law.slope(-now);
    double slope;
    if (std::abs(step) < kClose * size || step == 0.0) {
        const double reach = size > 0.0 ? kClose * size : 1e-12;
        slope = (law.slope(-(middle - reach)) - law.slope(-(middle + reach))) / (4 * reach);
    } else
        slope = (at_now - gradient) / step;
    return {gradient + (law.loss * std::abs(gradient) + law.damping) * (step / dt),
            std::max(slope, 0.0) + (law.loss * std::abs(at_now) + law.damping) / dt};
}

// Force and slope over a step that takes the compression from `old` to `now`.
inline LawForce evaluate_law(const Law& law, double now, double old, double dt) {
    switch (law.kind) {
        case Law::contact: return contact_force(law, now, old, dt);
        case Law::spring: return spring_force(law, now, old, dt);
        case Law::sampled: return sampled_force(law, now, old, dt);
        case Law::compiled: return compiled_force(law, now, old, dt);
        case Law::friction: break;
    }
    return {0.0, 0.0};
}

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

}  // namespace
}  // namespace tonewood
