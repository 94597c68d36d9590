// A potential given by samples.
#pragma once

#include "base.hpp"

namespace tonewood {
namespace {

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

}  // namespace
}  // namespace tonewood
