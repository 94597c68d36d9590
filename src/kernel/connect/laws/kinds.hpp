// The kinds of laws with a potential, one file each; friction is solved on its branches (friction.hpp).
#pragma once

#include "compiled.hpp"
#include "contact.hpp"
#include "sampled.hpp"
#include "spring.hpp"

namespace tonewood {
namespace {

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

}  // namespace
}  // namespace tonewood
