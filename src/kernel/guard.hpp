// Contacts that touch nothing are left out, and nothing changes: bounds that say so with certainty.
//
// At the beginning of a block the free motion of a guarded port is bounded for all of it, by Cauchy-Schwarz over the
// modes, |row| <= peak sqrt(norm), or, closer, by its value in the middle of the block and how far each mode can carry
// it from there; where known forces act, that is said of the motion about where their means would hold the string. What
// is left to the contact is its slack. The forces of the block use it up: |row| moves by at most
// reach |F| for each port force F. While the sum stays below the slack the contact sleeps; the step in which it does
// not is looked at again with the contact's own row, read from the block's beginning.
#pragma once

#include <algorithm>
#include <cmath>

#include "sweep.hpp"

namespace tonewood {
namespace {

// Room for rounding in the bounds, relative to the motion.
constexpr double kMargin = 1e-11;

// Square root of the weighted squares of all modes of a state or an input.
double norm(const Component& c, const double* x, const double* y) {
    using V = Simd::V;
    using S = Simd;
    V sum{}, more{};
    for (int k = 0; k < c.n; k += S::width) {
        const V a = S::load(x + k), b = S::load(y + k);
        sum += S::load(c.guarded.norm.data() + k) * a * a;
        more += S::load(c.guarded.norm.data() + c.n + k) * b * b;
    }
    alignas(64) double lanes[S::width];
    S::store(lanes, sum + more);
    return std::sqrt(S::sum(lanes));
}

// Upper bounds of |Re z| of turning modes: max + (sqrt 2 - 1) min of the two numbers.
void sizes(const Component& c, const double* x, const double* y, double* out) {
    for (int k = 0; k < c.n; ++k) {
        const double a = std::abs(x[k]), b = c.guarded.size[k] * std::abs(y[k]);
        out[k] = (a > b ? a : b) + 0.41421357 * (a > b ? b : a);
    }
}

struct Surroundings {
    double middle, spread;
};

// Where a guarded port is in the middle of the block, and how far from there it may be in it.
Surroundings surroundings(const Component& c, int port, const double* x, const double* y, const double* size) {
    using V = Simd::V;
    using S = Simd;
    const std::size_t n = c.n;
    const double *row = c.guarded.middle.data() + 2 * port * n, *far = c.guarded.spread.data() + port * n;
    V middle{}, more{}, spread{};
    for (std::size_t k = 0; k < n; k += S::width) {
        middle += S::load(row + k) * S::load(x + k);
        more += S::load(row + n + k) * S::load(y + k);
        spread += S::load(far + k) * S::load(size + k);
    }
    alignas(64) double lanes[2][S::width];
    S::store(lanes[0], middle + more);
    S::store(lanes[1], spread);
    return {S::sum(lanes[0]), S::sum(lanes[1])};
}

}  // namespace
}  // namespace tonewood
