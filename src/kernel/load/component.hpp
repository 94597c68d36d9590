// A component from its description: its arrays checked and copied, and the tables of the modal passes derived.
#pragma once

#include <algorithm>
#include <cmath>

#include "bound_tables.hpp"
#include "description.hpp"

namespace tonewood {

static_assert((kBlock & (kBlock - 1)) == 0, "E^kBlock is made by squaring");

// rows (E - I), of `count` rows of n modes
inline Array<double> slopes_of(std::size_t n, const double* e, const double* rows, std::size_t count) {
    Array<double> out(2 * count * n);
    for (std::size_t r = 0; r < count; ++r)
        for (std::size_t k = 0; k < n; ++k) {
            const double rx = rows[2 * r * n + k], ry = rows[(2 * r + 1) * n + k];
            out[2 * r * n + k] = rx * (e[k] - 1) + ry * e[2 * n + k];
            out[(2 * r + 1) * n + k] = rx * e[n + k] + ry * (e[3 * n + k] - 1);
        }
    return out;
}

// (E - tr) w, or of slow modes (I + E - tr) w
inline Array<double> w_slopes_of(const Component& c, const double* w, std::size_t count) {
    const std::size_t n = c.n;
    const double* const e = c.e.data();
    Array<double> out(2 * count * n);
    for (std::size_t q = 0; q < count; ++q)
        for (std::size_t k = 0; k < n; ++k) {
            const double wx = w[2 * q * n + k], wy = w[(2 * q + 1) * n + k];
            const double one = c.slow[k / kGranule];
            out[2 * q * n + k] = (one - e[3 * n + k]) * wx + e[n + k] * wy;
            out[(2 * q + 1) * n + k] = e[2 * n + k] * wx + (one - e[k]) * wy;
        }
    return out;
}

// Derives the tables of the recurrences of modal/pass.hpp.
inline void derive_recurrences(Component& c) {
    const std::size_t n = c.n;
    const double* const e = c.e.data();
    c.trace.resize(n), c.det.resize(n), c.kappa.resize(n), c.e_block.resize(4 * n);
    c.slow.assign((n + kGranule - 1) / kGranule, 0);
    for (std::size_t k = 0; k < n; ++k) {
        const double a = e[k], b = e[n + k], g = e[2 * n + k], d = e[3 * n + k];
        c.trace[k] = a + d, c.det[k] = a * d - b * g;
        const double kappa = c.kappa[k] = (1 - a) * (1 - d) - b * g;
        // an angle below 0.22 per sample; padding does not count
        if (kappa < 0.05) c.slow[k / kGranule] = 1;
        double p[4] = {a, b, g, d};
        for (int squared = 1; squared < kBlock; squared *= 2) {
            const double q[4] = {p[0] * p[0] + p[1] * p[2], p[1] * (p[0] + p[3]), p[2] * (p[0] + p[3]),
                                 p[1] * p[2] + p[3] * p[3]};
            for (int i = 0; i < 4; ++i) p[i] = q[i];
        }
        for (int i = 0; i < 4; ++i) c.e_block[i * n + k] = p[i];
    }
    for (std::size_t k = 0; c.n_rows == 2 && k < n; ++k) {  // real modes: both rows are shapes times the same numbers
        const double *const at = c.rows.data() + k, x = at[0], y = at[n], x2 = at[2 * n], y2 = at[3 * n];
        const double size = x * x + y * y, ratio = size > 0.0 ? (x * x2 + y * y2) / size : 0.0;
        if (!(std::hypot(x2 - ratio * x, y2 - ratio * y) <= 1e-14 * std::hypot(x2, y2))) {
            c.ratio.clear();
            break;
        }
        c.ratio.push_back(ratio);
    }
    c.slopes = slopes_of(n, e, c.rows.data(), c.n_rows), c.w_slope = w_slopes_of(c, c.w.data(), c.n_ports);
}

// Derives the tables of modal/fused_pass.hpp; none if a mode has several rows, or its state does not follow from the
// values of its row.
inline void derive_port_recurrence(Component& c) {
    constexpr std::size_t chunk = kChunk;
    const std::size_t n = c.n;
    const double *const e = c.e.data(), *const rows = c.rows.data(), *const w = c.w.data();
    if (c.n_ports < 1 || c.n_ports > 2 || c.n_rows == 0) return;
    PortRecurrence out;
    out.n_ports = c.n_ports, out.step = (4 + 2 * c.n_ports) * chunk;
    std::vector<int> row(n, -1);
    for (std::size_t k = 0; k < n; ++k) {
        bool padding = true;
        for (int i = 0; i < 4; ++i) padding = padding && e[i * n + k] == 0.0;
        for (int r = 0; r < c.n_rows; ++r)
            if (rows[2 * r * n + k] != 0.0 || rows[(2 * r + 1) * n + k] != 0.0) {
                if (row[k] >= 0) return;
                row[k] = r;
            }
        if (row[k] < 0 && !padding) return;
    }
    for (std::size_t k = 0; k < n;) {
        if (row[k] < 0) {
            ++k;
            continue;
        }
        std::size_t end = k;
        bool slow = false;
        for (; end < std::min(k + chunk, n) && row[end] == row[k]; ++end) slow = slow || c.kappa[end] < 0.02;
        const std::size_t first = k, at = out.chunks.size();
        out.chunks.push_back({int(k), int(end - k), row[k], slow});
        out.numbers.resize((at + 1) * out.step, 0.0);
        out.basis.resize((at + 1) * PortRecurrence::basis_step, 0.0);
        for (; k < end; ++k) {
            double* const numbers = out.numbers.data() + at * out.step + k - first;
            double* const basis = out.basis.data() + (at * PortRecurrence::basis_step + k - first);
            const double a = e[k], b = e[n + k], g = e[2 * n + k], d = e[3 * n + k];
            const double rx = rows[2 * row[k] * n + k], ry = rows[(2 * row[k] + 1) * n + k], one = slow;
            const double tx = rx * (a - one) + ry * g, ty = rx * b + ry * (d - one);
            numbers[0] = slow ? c.kappa[k] : c.trace[k], numbers[chunk] = c.det[k];
            bool first_only = b == 0.0 && g == 0.0 && ry == 0.0;
            for (int p = 0; p < c.n_ports; ++p) {
                const double wx = w[2 * p * n + k], wy = w[(2 * p + 1) * n + k];
                first_only = first_only && wy == 0.0;
                numbers[(4 + 2 * p) * chunk] = rx * wx + ry * wy, numbers[(5 + 2 * p) * chunk] = tx * wx + ty * wy;
            }
            basis[0] = rx, basis[chunk] = ry, basis[2 * chunk] = tx, basis[3 * chunk] = ty;
            if (first_only) {  // a real pole: its second number stays zero
                basis[4 * chunk] = 1 / rx;
                continue;
            }
            const double det = rx * ty - ry * tx;
            if (std::abs(det) < 0.02 * (std::abs(rx * ty) + std::abs(ry * tx)) || det == 0.0) return;
            basis[4 * chunk] = ty / det, basis[5 * chunk] = -ry / det;
            basis[6 * chunk] = -tx / det, basis[7 * chunk] = rx / det;
        }
    }
    c.recurrence = std::move(out);
}

// Derives the tables of modal/shape_step.hpp if every mode moves all ports by one number times its shape there.
inline void derive_shapes(Component& c) {
    const std::size_t n = c.n, p = c.n_ports;
    if (c.driven || c.n_ports < kLeastShapes) return;
    Shapes out;
    out.on = true, out.width = padded(p);
    out.phi.assign(n * out.width, 0.0);
    out.read.assign(2 * n, 0.0), out.drive = out.read, out.read_next = out.read;
    const auto largest = [&](const Array<double>& a, std::size_t k) {
        std::size_t best = 0;
        double most = -1.0;
        for (std::size_t q = 0; q < p; ++q)
            if (const double size = std::hypot(a[2 * q * n + k], a[(2 * q + 1) * n + k]); size > most)
                most = size, best = q;
        return best;
    };
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t best = largest(c.rows, k);
        for (int i = 0; i < 2; ++i)
            out.read[i * n + k] = c.rows[(2 * best + i) * n + k], out.drive[i * n + k] = c.w[(2 * best + i) * n + k];
        const double rx = out.read[k], ry = out.read[n + k], wx = out.drive[k], wy = out.drive[n + k];
        const double size = rx * rx + ry * ry;
        for (std::size_t q = 0; q < p; ++q) {
            const double x = c.rows[2 * q * n + k], y = c.rows[(2 * q + 1) * n + k];
            const double phi = size > 0.0 ? (x * rx + y * ry) / size : 0.0;
            const double off_row = std::hypot(x - phi * rx, y - phi * ry);
            const double off_drive = std::hypot(c.w[2 * q * n + k] - phi * wx, c.w[(2 * q + 1) * n + k] - phi * wy);
            if (!(off_row <= 1e-14 * std::sqrt(size) && off_drive <= 1e-14 * std::hypot(wx, wy))) return;
            out.phi[k * out.width + q] = phi;
        }
        out.read_next[k] = rx * c.e[k] + ry * c.e[2 * n + k];
        out.read_next[n + k] = rx * c.e[n + k] + ry * c.e[3 * n + k];
    }
    c.shapes = std::move(out);
}

// (kBlock, ports, rows) with the samples last
inline Array<double> by_pair(const View& h) {
    const std::size_t pairs = h.shape[1] * h.shape[2];
    Array<double> out(pairs * kBlock);
    for (std::size_t k = 0; k < kBlock; ++k)
        for (std::size_t i = 0; i < pairs; ++i) out[i * kBlock + k] = h[k * pairs + i];
    return out;
}

inline void load_contact_ports(Component& c, const ContactPortsDescription& d, const std::string& name) {
    const std::size_t n = c.n, fixed = c.n_ports, n_rows = c.n_rows, count = d.rows.ndim == 3 ? d.rows.shape[0] : 0;
    expect(name + "contact_rows", d.rows, {count, 2, n});
    expect(name + "contact_w", d.w, {count, 2, n});
    expect(name + "from_fixed", d.from_fixed, {kBlock, fixed, count});
    expect(name + "from_contact", d.from_contact, {kBlock, count, count});
    expect(name + "on_rows", d.on_rows, {kBlock, count, n_rows});
    require(!c.driven, name + "contact_rows: a component driven one way has no contact ports");
    ContactPorts& g = c.contact;
    g.n = int(count), g.rows = d.rows.copy(), g.w = d.w.copy();
    g.slopes = slopes_of(n, c.e.data(), g.rows.data(), count), g.w_slope = w_slopes_of(c, g.w.data(), count);
    g.from_fixed = by_pair(d.from_fixed), g.from_contact = by_pair(d.from_contact);
    g.on_rows.resize(d.on_rows.size());
    for (std::size_t k = 0; k < kBlock; ++k)
        for (std::size_t p = 0; p < count; ++p)
            std::copy_n(d.on_rows.data + (k * count + p) * n_rows, n_rows,
                        g.on_rows.data() + (p * kBlock + k) * n_rows);
    derive_bounds(c);
}

// Derives the tables of modal/scaled_modes.hpp.
inline void derive_scaled(Component& c, const std::string& name) {
    Coordinates& s = c.coordinates;
    const double *const e = c.e.data(), *const gain = s.gain.data();
    const std::size_t n = c.n, p = c.n_ports, step = kScaledNumbers + p;
    s.numbers.assign(n * step, 0.0), s.basis.assign(8 * n, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double g = gain[k], e00 = e[k], e01 = e[n + k], e10 = e[2 * n + k], e11 = e[3 * n + k];
        if (g == 0.0 && e00 == 0.0) continue;  // padding
        require(g > 0.0 && e01 != 0.0, name + "kick: mode " + std::to_string(k) + " has no compliance");
        const double root = std::sqrt(g), det = e00 * e11 - e01 * e10, tilt = gain[n + k] / g;
        double* const to = s.numbers.data() + (k / kPadding * kPadding * step + k % kPadding);
        const double numbers[kScaledNumbers] = {
            2 * s.half[k] * s.middle[k], 2 * s.half[k] * s.middle[n + k], det, (1 - e00) * (1 - e11) - e01 * e10,
            e01 * tilt - e11 + det};
        s.n = k + 1, s.largest_first = std::max(s.largest_first, 2 * s.middle[k]);
        for (int i = 0; i < kScaledNumbers; ++i) to[i * kPadding] = numbers[i];
        for (std::size_t q = 0; q < p; ++q) to[(kScaledNumbers + q) * kPadding] = c.rows[2 * q * n + k] * root;
        const double basis[8] = {1 / root, (e00 - 1) / root, e01 / root,            // in
                                 root, (1 - e00) * root / e01, root / e01,          // out
                                 -e11 / root, e01 / root};                          // of known inputs to v, at the end
        for (int i = 0; i < 8; ++i) s.basis[i * n + k] = basis[i];
    }
}

inline void load_coordinates(Component& c, const CoordinatesDescription& d, const std::string& name) {
    const std::size_t n = c.n, p = c.n_ports;
    expect(name + "reading", d.reading, {n});
    expect(name + "stiffness", d.stiffness, {n});
    expect(name + "kick", d.kick, {2, n});
    expect(name + "velocity", d.velocity, {3, n});
    expect(name + "middle", d.middle, {2, n});
    expect(name + "a", d.a, {n});
    require(!c.driven && n > 0 && p <= kMaxScaledPorts,
            name + "reading: no potential acts on a driven component, or on one of more than " +
                std::to_string(kMaxScaledPorts) + " ports");
    Coordinates& s = c.coordinates;
    s.reading = d.reading.copy(), s.stiffness = d.stiffness.copy(), s.kick = d.kick.copy();
    s.velocity = d.velocity.copy(), s.a = d.a.copy();
    s.middle = d.middle.copy();
    s.half.assign(n, 0.0), s.gain.assign(2 * n, 0.0);
    for (std::size_t k = 0; k < n; ++k) s.half[k] = 0.5 * (s.reading[k] * s.kick[k]) * s.a[k];
    s.largest_half = *std::max_element(s.half.begin(), s.half.end());
    for (std::size_t k = 0; k < 2 * n; ++k)
        if (const double r = s.reading[k % n]; r != 0.0) s.gain[k] = s.kick[k] / r;
    derive_scaled(c, name);
    derive_tension_reach(c);
}

// Component number `slot` of a state of `capacity` modes.
inline Component load_component(const ComponentDescription& d, std::size_t slot, std::size_t capacity, int n_channels) {
    const std::string name = "components[" + std::to_string(slot) + "].";
    require(d.e.ndim == 2 && d.rows.ndim == 3 && d.w.ndim == 3, name + "e, rows, w have 2, 3, 3 dimensions");
    const std::size_t n = d.e.shape[1], n_rows = d.rows.shape[0], n_ports = d.w.shape[0];
    const std::size_t n_connections = d.incidence.ndim == 2 ? d.incidence.shape[0] : 0;
    expect(name + "e", d.e, {4, n});
    expect(name + "rows", d.rows, {n_rows, 2, n});
    expect(name + "w", d.w, {n_ports, 2, n});
    expect(name + "response", d.response, {kBlock, n_ports, n_rows});
    expect(name + "incidence", d.incidence, {n_connections, n_ports});
    require(n > 0 && n % kPadding == 0 && d.offset % kPadding == 0 && d.offset + n >= n && d.offset + n <= capacity,
            name + "offset: the modes do not fit the state");
    require(d.difference.size() == d.channels.size() && n_rows == d.channels.size() + (d.driven ? 0 : n_ports),
            name + "rows: one for each port and readout is needed");
    for (const int channel : d.channels)
        require(channel >= 0 && channel < n_channels, name + "channels: no channel " + std::to_string(channel));
    Component c;
    c.n = int(n), c.n_ports = int(n_ports), c.n_rows = int(n_rows), c.offset = d.offset, c.driven = d.driven;
    c.e = d.e.copy(), c.rows = d.rows.copy(), c.w = d.w.copy(), c.response = d.response.copy();
    derive_recurrences(c);
    derive_port_recurrence(c);
    derive_shapes(c);
    c.shares.resize(n_ports);
    for (std::size_t j = 0; j < n_connections; ++j)
        for (std::size_t p = 0; p < n_ports; ++p)
            if (const double a = d.incidence[j * n_ports + p]; a != 0.0) c.shares[p].push_back({int(j), a});
    c.channels = d.channels, c.difference.assign(d.difference.begin(), d.difference.end());
    if (d.has_contact_ports) load_contact_ports(c, d.contact, name);
    if (d.has_coordinates) load_coordinates(c, d.coordinates, name);
    return c;
}

}  // namespace tonewood
