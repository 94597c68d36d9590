// One-sided contact K p^n (1 + loss p'), by the discrete gradient of its potential; the equations are in
// tonewood.physics.coupling.laws.contact.
#pragma once

#include "base.hpp"

namespace tonewood {
namespace {

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

}  // namespace
}  // namespace tonewood
