// Bounds on the motion of a contact port throughout a block.
//
// The free motion is bounded by Cauchy-Schwarz over the modes, |row| <= peak sqrt(norm), or more closely by its value
// in the middle of the block and the largest change of each mode from there. A port force F moves the row by at most
// reach |F|. load/contact_groups.hpp derives peak, norm, spread and reach.
#pragma once

#include <algorithm>
#include <cmath>

#include "../modal/pass.hpp"

namespace tonewood {
namespace {

// Allowance for rounding in the bounds, relative to the motion.
constexpr double kMargin = 1e-11;

// Square root of the weighted squares of all modes of a state or an input.
double norm(const Component& c, const double* x, const double* y) {
    using V = Simd::V;
    using S = Simd;
    V sum{}, more{};
    for (int k = 0; k < c.n; k += S::width) {
        const V a = S::load(x + k), b = S::load(y + k);
        sum += S::load(c.contact.norm.data() + k) * a * a;
        more += S::load(c.contact.norm.data() + c.n + k) * b * b;
    }
    return std::sqrt(S::sum(sum + more));
}

// Upper bounds of |Re z| of oscillating modes: max + (sqrt 2 - 1) min of the two numbers.
void amplitudes(const Component& c, const double* x, const double* y, double* out) {
    for (int k = 0; k < c.n; ++k) {
        const double a = std::abs(x[k]), b = c.contact.size[k] * std::abs(y[k]);
        out[k] = (a > b ? a : b) + 0.41421357 * (a > b ? b : a);
    }
}

// Displacement of a contact port in the middle of the block, and its largest change from there in the block.
struct Excursion {
    double middle, spread;
};

Excursion excursion_of(const Component& c, int port, const double* x, const double* y, const double* amplitude) {
    using V = Simd::V;
    using S = Simd;
    const std::size_t n = c.n;
    const double *row = c.contact.middle.data() + 2 * port * n, *far = c.contact.spread.data() + port * n;
    V middle{}, more{}, spread{};
    for (std::size_t k = 0; k < n; k += S::width) {
        middle += S::load(row + k) * S::load(x + k);
        more += S::load(row + n + k) * S::load(y + k);
        spread += S::load(far + k) * S::load(amplitude + k);
    }
    return {S::sum(middle + more), S::sum(spread)};
}

}  // namespace
}  // namespace tonewood
