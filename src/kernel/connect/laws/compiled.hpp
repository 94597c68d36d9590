// A potential given as C functions.
#pragma once

#include "base.hpp"

namespace tonewood {
namespace {

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

}  // namespace
}  // namespace tonewood
