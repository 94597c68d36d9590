// Strings under rising tension and strings with longitudinal motion as loaded.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "../data/state.hpp"
#include "description.hpp"

namespace tonewood {

// Coefficients of sums over a polarization's modes for each pair of its ports; see Tensions::String.
inline void derive_pairs(const Component& c, int at, Tensions::String& string) {
    const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
    for (int p = 0; p < c.n_ports; ++p)
        for (int q = 0; q < c.n_ports; ++q) {
            auto& once = string.once[std::size_t(at + p) * string.n + at + q];
            auto& twice = string.twice[std::size_t(at + p) * string.n + at + q];
            for (int k = 0; k < c.n; ++k) {
                const double* const numbers = c.tension.numbers.data() + k / kPadding * step + k % kPadding;
                const double h = numbers[0],
                             rr = numbers[(kScaledNumbers + p) * kPadding] * numbers[(kScaledNumbers + q) * kPadding];
                once[0] += h * rr, once[1] -= h * h * rr;
                twice[0] += h * h * rr, twice[1] -= 2 * h * h * h * rr, twice[2] += h * h * h * h * rr;
            }
        }
}

// Forces on the strings' ports per displacement of each, -s^T (B - B U K U^T B) s, s their shares of connections.
inline void answer_in_parts(const Solve& solve, Tensions& t) {
    const std::size_t n = t.ports.size(), m = solve.m, r = solve.hub.ports.size();
    Array<double> blocks(n * m, 0.0), reach(n * r, 0.0), joined(n * r, 0.0);  // B s, U^T B s, K U^T B s
    std::vector<std::vector<Entry>> columns(m);
    for (const Entry& e : solve.blocks) columns[e.column].push_back(e);
    for (std::size_t p = 0; p < n; ++p) {
        for (const Share& s : t.ports[p].shares)
            for (const Entry& e : columns[s.connection]) blocks[p * m + e.row] += e.value * s.factor;
        for (std::size_t j = 0; r && j < m; ++j)
            if (const double x = blocks[p * m + j]; x != 0.0 && solve.hub.point[j] >= 0)
                for (std::size_t i = 0; i < r; ++i)
                    reach[p * r + i] +=
                        solve.hub.span[std::size_t(solve.hub.point[j]) * r + i] * solve.hub.factor[j] * x;
        for (std::size_t i = 0; i < r; ++i)
            for (std::size_t j = 0; j < r; ++j) joined[p * r + i] += solve.hub.joined[i * r + j] * reach[p * r + j];
    }
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t q = 0; q < n; ++q) {
            double& to = t.onto_ports[p * t.width + q];
            for (const Share& s : t.ports[q].shares) to -= s.factor * blocks[p * m + s.connection];
            for (std::size_t i = 0; i < r; ++i) to += reach[q * r + i] * joined[p * r + i];
        }
}

// Numbers the polarizations and their fixed ports, folds the answer of the linear connections to displacements of these
// into matrices, and makes the buffers of a run.
inline void make_tensions(const std::vector<Component>& components, const Solve& solve, const Layout& l, Tensions& t,
                          std::size_t capacity, const Nonlinear& nl, TensionState& ws) {
    t.parts.clear(), t.ports.clear(), t.n_sums = 0;
    if (t.strings.empty()) return;
    std::vector<int> place(components.size(), 0);
    for (std::size_t i = 0, ports = 0; i < components.size(); ++i) {
        place[i] = int(ports);
        if (!components[i].driven) ports += components[i].n_ports;
    }
    const std::size_t strings = t.strings.size(), n_places = l.port_rows.size(), lane = padded(strings);
    for (std::size_t s = 0; s < strings; ++s) {
        Tensions::String& string = t.strings[s];
        string.root = 2 * std::sqrt(string.kappa), string.highest = 0.0;
        string.first = int(t.ports.size()), string.n = 0, string.first_part = int(t.parts.size());
        for (const int i : string.components) string.n += components[i].n_ports;
        string.once.assign(std::size_t(string.n) * string.n, {});
        string.twice.assign(std::size_t(string.n) * string.n, {});
        for (const int i : string.components) {
            const Component& c = components[i];
            string.highest = std::max(string.highest, c.tension.largest_half);
            derive_pairs(c, int(t.ports.size()) - string.first, string);
            t.parts.push_back({i, int(s), int(t.ports.size()), t.n_sums});
            t.n_sums += kSharedSums + std::size_t(kPortSums) * c.n_ports;
            for (int p = 0; p < c.n_ports; ++p)
                t.ports.push_back({int(s), l.row[i] + p, l.port[i] + p, place[i] + p, c.shares[p]});
        }
        string.steady.clear();
        for (int p = 0; p < string.n; ++p)
            string.steady.push_back(std::sqrt(0.5 * string.once[std::size_t(p) * string.n + p][0]));
    }
    const std::size_t n = t.ports.size(), width = padded(n);
    t.width = int(width);
    t.onto_ports.assign(n * width, 0.0);
    const std::size_t of_one_matrix = l.in_parts ? 0 : n;
    t.onto_forces.assign(of_one_matrix * l.force_width, 0.0), t.onto_linear.assign(of_one_matrix * l.f_width, 0.0);
    if (l.in_parts) answer_in_parts(solve, t);
    for (std::size_t p = 0; p < of_one_matrix; ++p) {
        const std::size_t from = t.ports[p].place;
        const double *linear = l.gather.data() + ((n_places + from) * l.f_width),
                     *forces = l.direct.free.data() + from * l.force_width;
        std::copy_n(linear, l.f_width, t.onto_linear.data() + p * l.f_width);
        std::copy_n(forces, l.force_width, t.onto_forces.data() + p * l.force_width);
        for (std::size_t q = 0; q < n; ++q) t.onto_ports[p * width + q] = forces[t.ports[q].force];
    }
    const std::size_t n_sums = (t.n_sums + kPadding - 1) / kPadding * kPadding, k = nl.k;
    ws.scaled.assign(kScaledState * capacity, 0.0);
    ws.lanes.assign(n_sums * 8, 0.0), ws.sums.assign(n_sums, 0.0);
    for (Array<double>* a :
         {&ws.psi, &ws.mean, &ws.alone, &ws.spread, &ws.bound, &ws.past[0], &ws.past[1], &ws.past[2], &ws.over})
        a->assign(lane, 0.0);
    for (Array<double>* a : {&ws.reach, &ws.driven, &ws.answering, &ws.forces}) a->assign(width, 0.0);
    ws.stiff.assign(strings * width, 0.0);
    for (Array<double>* a : {&ws.matrix, &ws.upper}) a->assign(strings * lane, 0.0);
    ws.linear.assign(l.f_width, 0.0), ws.y.assign(padded(n_places) + 2 * kLane, 0.0);
    ws.has_meets.assign(k, 0), ws.meets.assign(k * width, 0.0), ws.z.assign(k * k, 0.0);
    ws.gap.assign(k * lane, 0.0), ws.solved.assign(strings * padded(k), 0.0), ws.row.assign(padded(k), 0.0);
}

// Part of a string with longitudinal motion; `c` is its component.
inline Stretch::Part load_part(const StretchDescription::Part& d, const Component& c, bool longitudinal,
                               const std::string& name) {
    require(d.slopes.ndim == 2, name + "slopes has 2 dimensions");
    const std::size_t n = d.slopes.shape[1], cosines = d.slopes.shape[0], w = padded(n);
    const std::size_t modes = (n + kPadding - 1) / kPadding * kPadding;
    expect(name + "stiffness", d.stiffness, {n});
    require(!c.driven && !c.contact.n && n > 0 && n <= std::size_t(c.n) && cosines > 0 && (longitudinal || cosines == 1),
            name + "slopes: they do not fit the component");
    Stretch::Part part;
    part.component = d.slot, part.n = int(n), part.width = int(w), part.cosines = int(cosines);
    part.cosines_width = int(padded(cosines));
    part.slopes.assign(n * part.cosines_width, 0.0), part.back.assign(cosines * w, 0.0);
    part.stretch.assign(modes, 0.0);
    if (!longitudinal) std::copy_n(d.slopes.data, n, part.stretch.begin());
    for (std::size_t i = 0; longitudinal && i < cosines; ++i)
        for (std::size_t k = 0; k < n; ++k)
            part.slopes[k * part.cosines_width + i] = part.back[i * w + k] = d.slopes[i * n + k];
    part.stiffness.assign(modes, 0.0), std::copy_n(d.stiffness.data, n, part.stiffness.begin());
    part.scale.assign(modes, 0.0);
    for (std::size_t k = 0; k < n; ++k) part.scale[k] = c.tension.reading[k] * std::sqrt(c.tension.gain[k]);
    return part;
}

// Strings with longitudinal motion, in the order of `strings`.
inline std::vector<Stretch> load_stretches(const std::vector<StretchDescription>& strings,
                                           std::vector<Component>& components) {
    std::vector<Stretch> out;
    for (std::size_t s = 0; s < strings.size(); ++s) {
        const StretchDescription& d = strings[s];
        const std::string name = "tensions.stretches[" + std::to_string(s) + "].";
        require(d.parts.size() >= (d.longitudinal ? 2u : 1u), name + "parts: too few");
        Stretch string;
        string.scale = d.scale, string.longitudinal = d.longitudinal;
        for (std::size_t q = 0; q < d.parts.size(); ++q)
            string.parts.push_back(load_part(d.parts[q], components[d.parts[q].slot], d.longitudinal,
                                             name + "parts[" + std::to_string(q) + "]."));
        string.order = string.parts.back().cosines - 1;
        out.push_back(std::move(string));
    }
    return out;
}

}  // namespace tonewood
