// A spring that hardens, with dashpots.
#pragma once

#include "base.hpp"

namespace tonewood {
namespace {

inline LawForce spring_force(const Law& law, double now, double old, double dt) {
    const double k = law.a[0], k3 = law.a[1], d = law.a[2];
    const double total = now + old, squares = now * now + old * old, rate = (now - old) / dt;
    const double f = total * (0.5 * k + 0.25 * k3 * squares) + (law.damping + d * std::abs(rate)) * rate;
    const double slope = 0.5 * k + 0.25 * k3 * (squares + 2 * now * total);
    return {f, slope + (law.damping + 2 * d * std::abs(rate)) / dt};
}

// Whether the force of a law is linear in its compressions.
inline bool is_linear(const Law& law) { return law.kind == Law::spring && law.a[1] == 0.0 && law.a[2] == 0.0; }

// Slopes of a linear law with the compression after and before the step: spring and dashpot, each alone.
struct LinearLaw {
    double spring, dashpot;
};
inline LinearLaw linear_law(const Law& law, double dt) { return {0.5 * law.a[0], law.damping / dt}; }

}  // namespace
}  // namespace tonewood
