// Nonlinear laws over one step; the formulas and their reasons are in tonewood.physics.coupling.laws, a file for each.
#pragma once

#include <algorithm>
#include <cmath>

#include "../../data/state.hpp"

namespace tonewood {
namespace {

struct LawForce {
    double force, slope;  // N; N/m with the new compression
};

constexpr double kClose = 1e-4;  // relative step below which slopes of discrete gradients are those at the middle

}  // namespace
}  // namespace tonewood
