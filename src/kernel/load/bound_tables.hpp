// Tables of the bounds on contact rows (cull/row_bounds.hpp).
#pragma once

#include <algorithm>
#include <cmath>

#include "../data/component.hpp"

namespace tonewood {

// Derives bounds on the rows of contact ports throughout a block. The amplitude of a mode with the numbers (u, v) is
// hypot(u, s v), s such that it is constant while the mode oscillates, and the way of the block where it drifts.
inline void derive_bounds(Component& c) {
    ContactPorts& contact = c.contact;
    const double *const e = c.e.data(), *const rows = contact.rows.data();
    const std::size_t n = c.n, n_contact = contact.n;
    contact.norm.assign(2 * n, 0.0), contact.size.assign(n, 0.0);
    contact.middle.assign(2 * n_contact * n, 0.0), contact.spread.assign(n_contact * n, 0.0);
    contact.peak.assign(n_contact, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double e00 = e[k], e01 = e[n + k], e10 = e[2 * n + k], e11 = e[3 * n + k];
        const double constant = std::abs(e10) > 0.0 ? std::sqrt(std::abs(e01 / e10)) : 1.0;
        const double s = std::abs(e01) > 0.0 ? std::min(constant, kBlock * std::abs(e01)) : 1.0;
        const double stiffness = std::max((1 - e00) * (1 - e11) - e01 * e10, 1e-8);
        contact.size[k] = s, contact.norm[k] = stiffness, contact.norm[n + k] = stiffness * s * s;
        for (std::size_t g = 0; g < n_contact; ++g) {
            double a[kBlock + 1], b[kBlock + 1], all = 0.0, far = 0.0;
            a[0] = rows[2 * g * n + k], b[0] = rows[(2 * g + 1) * n + k];
            for (int j = 0; j < kBlock; ++j) {
                a[j + 1] = a[j] * e00 + b[j] * e10;
                b[j + 1] = a[j] * e01 + b[j] * e11;
            }
            const double a_mid = a[kBlock / 2], b_mid = b[kBlock / 2];
            for (int j = 0; j <= kBlock; ++j) {
                const double da = a[j] - a_mid, db = (b[j] - b_mid) / s;
                all = std::max(all, a[j] * a[j] + b[j] * b[j] / (s * s));
                far = std::max(far, da * da + db * db);
            }
            contact.peak[g] += all / stiffness;
            if (far < all) {
                contact.middle[2 * g * n + k] = a_mid;
                contact.middle[(2 * g + 1) * n + k] = b_mid;
            }
            contact.spread[g * n + k] = std::sqrt(std::min(far, all));
        }
    }
    for (double& peak : contact.peak) peak = std::sqrt(peak);
}

// Derives the largest displacement of contact rows in the rest of a block by the forces of a rising tension, per
// psi_m sqrt(sum g^2 / a): these forces are -psi_m g on each mode.
inline void derive_tension_reach(Component& c) {
    ContactPorts& g = c.contact;
    const Coordinates& s = c.coordinates;
    const std::size_t n = c.n;
    g.tension_reach.assign(g.n, 0.0);
    for (std::size_t r = 0; r < std::size_t(g.n); ++r) {
        double most[kBlock] = {};
        for (std::size_t k = 0; k < n; ++k) {
            const double e00 = c.e[k], e01 = c.e[n + k], e10 = c.e[2 * n + k], e11 = c.e[3 * n + k];
            const double rx = g.rows[2 * r * n + k], ry = g.rows[(2 * r + 1) * n + k];
            double u = s.kick[k], v = s.kick[n + k];
            for (int j = 0; j < kBlock; ++j) {
                const double moved = rx * u + ry * v, next = e00 * u + e01 * v;
                most[j] += moved * moved * s.a[k];
                v = e10 * u + e11 * v, u = next;
            }
        }
        g.tension_reach[r] = std::sqrt(*std::max_element(most, most + kBlock));
    }
}

// (all ports, all ports), fixed ones first: largest displacement of a port in a block per force on each.
inline Array<double> reach_of(const Component& c) {
    const ContactPorts& g = c.contact;
    const std::size_t all = c.n_ports + g.n, fixed = c.n_ports, n_rows = c.n_rows, n = g.n;
    Array<double> reach(all * all, 0.0);
    const auto take = [&](std::size_t row, std::size_t port, double h) {
        reach[row * all + port] = std::max(reach[row * all + port], std::abs(h));
    };
    for (std::size_t k = 0; k < kBlock; ++k) {
        for (std::size_t p = 0; p < fixed; ++p) {
            for (std::size_t r = 0; r < fixed; ++r) take(r, p, c.response[(k * fixed + p) * n_rows + r]);
            for (std::size_t r = 0; r < n; ++r) take(fixed + r, p, g.from_fixed[(p * n + r) * kBlock + k]);
        }
        for (std::size_t p = 0; p < n; ++p) {
            for (std::size_t r = 0; r < fixed; ++r) take(r, fixed + p, g.on_rows[(p * kBlock + k) * n_rows + r]);
            for (std::size_t r = 0; r < n; ++r) take(fixed + r, fixed + p, g.from_contact[(p * n + r) * kBlock + k]);
        }
    }
    return reach;
}

}  // namespace tonewood
