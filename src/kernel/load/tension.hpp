// Strings under rising tension and strings with longitudinal motion as loaded.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "../data/state.hpp"
#include "description.hpp"

namespace tonewood {

// Numbers the fixed ports of components under rising tension, and folds the answer of the linear connections to their
// displacements into matrices.
inline void make_tension_ports(const std::vector<Component>& components, const Layout& l, const Tensions& tensions,
                   TensionPorts& to) {
    to = TensionPorts{};
    const std::size_t n_strings = tensions.strings.size(), n_places = l.port_rows.size();
    const std::size_t strings = n_strings <= 2 ? n_strings : n_strings <= 4 ? 4 : padded(n_strings);
    for (const auto& string : tensions.strings) {
        to.most_components = std::max(to.most_components, int(string.components.size()));
        for (const int i : string.components) to.most_ports = std::max(to.most_ports, components[i].n_ports);
    }
    const std::size_t n = strings * to.most_components * to.most_ports, width = padded(n);
    for (int apart = 0; apart < to.most_ports; ++apart)
        for (int c = 0; c < to.most_components; ++c)
            for (int p = 0; p + apart < to.most_ports; ++p) {
                const int first = c * to.most_ports + p, here = int(strings);
                to.pairs.push_back({c, p, p + apart, int(to.pairs.size()) * here, first * here, (first + apart) * here});
            }
    to.strings = int(strings), to.width = int(width), to.pair_width = int(strings * to.pairs.size());
    to.ports.assign(n, {-1, 0, 0, 0, 0, 0});
    to.first.assign(components.size(), 0), to.string_of = to.first;
    to.own.assign(components.size(), 0);
    for (Array<double>* a : {&to.kappa, &to.over_kappa, &to.most, &to.low}) a->assign(strings, 0.0);
    to.over_most.assign(strings, 1.0), to.high.assign(strings, INFINITY);
    std::vector<int> place(components.size(), 0);
    for (std::size_t i = 0, ports = 0; i < components.size(); ++i) {
        place[i] = int(ports);
        if (!components[i].driven) ports += components[i].n_ports;
    }
    for (std::size_t s = 0; s < n_strings; ++s) {
        const auto& string = tensions.strings[s];
        to.kappa[s] = string.kappa, to.over_kappa[s] = string.kappa > 0.0 ? 1 / string.kappa : 0.0;
        to.most[s] = 1e-300, to.high[s] = 0.0;  // no interval yet
        for (std::size_t c = 0; c < string.components.size(); ++c) {
            const int i = string.components[c];
            std::size_t port = c * to.most_ports * strings + s;
            to.first[i] = int(port), to.string_of[i] = int(s);
            to.own[i] = kSharedSums * strings + port;
            to.most[s] = std::max(to.most[s], components[i].tension.largest_half);
            for (int p = 0; p < components[i].n_ports; ++p, port += strings) {
                to.ports[port] = {i, p, int(s), l.row[i] + p, l.port[i] + p, place[i] + p};
                to.real.push_back(int(port));
            }
        }
        to.over_most[s] = 1 / to.most[s];
    }
    to.changes.assign(std::size_t(kTaylor) * to.pair_width, 0.0);
    const std::size_t n_sums = (kSharedSums * strings + kPortSums * n + kPadding - 1) / kPadding * kPadding;
    to.lanes.assign(n_sums * 64, 0), to.sums.assign(n_sums, 0.0);
    to.y.assign(2 * n_places, 0.0), to.linear.assign(l.f_width, 0.0), to.fixed_part.assign(l.force_width, 0.0);
    for (Array<double>* a : {&to.alone, &to.moved, &to.force, &to.next, &to.residual, &to.base, &to.fixed})
        a->assign(width, 0.0);
    for (Array<double>* a : {&to.change_at, &to.slope_at, &to.bend_at, &to.change, &to.slope}) a->assign(to.pair_width, 0.0);
    to.onto_ports.assign(n * width, 0.0);
    to.inverse.assign(n * width, 0.0), to.pivots.assign(n, 0);
    to.onto_linear.assign(n * l.f_width, 0.0), to.onto_forces.assign(n * l.force_width, 0.0);
    for (const int p : to.real) {
        const std::size_t from = to.ports[p].place;
        const double *linear = l.gather.data() + ((n_places + from) * l.f_width), *forces = l.direct.data() + from * l.force_width;
        std::copy_n(linear, l.f_width, to.onto_linear.data() + std::size_t(p) * l.f_width);
        std::copy_n(forces, l.force_width, to.onto_forces.data() + std::size_t(p) * l.force_width);
        for (const int q : to.real) to.onto_ports[std::size_t(p) * width + q] = forces[to.ports[q].force];
    }
}

// Makes room for the responses of k laws on these ports (connect/coupled.hpp).
inline void make_law_buffers(std::size_t k, const Layout& l, TensionPorts& to) {
    const std::size_t n = to.ports.size(), width = to.width, wide = padded(k);
    to.has_response.assign(k, 0), to.law_forces.assign(l.force_width, 0.0);
    for (Array<double>* a : {&to.meets, &to.law_ports, &to.active_ports}) a->assign(k * width, 0.0);
    for (Array<double>* a : {&to.active_meets, &to.caught}) a->assign(n * wide, 0.0);
    for (Array<double>* a : {&to.law_slope, &to.given, &to.active_free, &to.active_force}) a->assign(wide, 0.0);
    to.law_free.assign(k, 0.0), to.sum.assign(width, 0.0), to.answers.assign(k * wide, 0.0);
    to.onto_with_laws = to.onto_ports, to.fixed_with_laws.assign(width, 0.0), to.folded = false;
    to.active.clear(), to.active.reserve(k);
}

// Components under rising tension, the linear connections that act on them, and the buffers of a run.
inline void make_tensions(std::vector<Component>& components, const Solve& solve, const Layout& layout, Tensions& tensions,
                          std::size_t capacity, const Nonlinear& nl, TensionState& ws) {
    const std::size_t m = solve.m, n = components.size();
    tensions.terms.clear();
    if (tensions.strings.empty()) return;
    for (std::size_t i = 0; i < n; ++i) {
        const Component& c = components[i];
        if (c.driven) continue;
        for (int p = 0; p < c.n_ports; ++p)
            for (const Share& s : c.shares[p]) tensions.terms.push_back({s.connection, int(i), p, s.factor});
    }
    for (Array<double>* a : {&ws.u, &ws.y, &ws.compliances}) a->assign(capacity, 0.0);
    ws.scaled.assign(kScaledState * capacity, 0.0);
    make_tension_ports(components, layout, tensions, ws.ports);
    for (Array<double>* a : {&ws.stretch, &ws.past, &ws.tension, &ws.used, &ws.at, &ws.after, &ws.pushed, &ws.sharp, &ws.far,
                             &ws.last_tension, &ws.last_excess, &ws.means[0], &ws.means[1], &ws.means[2]})
        a->assign(ws.ports.strings, 0.0);
    for (Array<double>* a : {&ws.fixed, &ws.right, &ws.scale, &ws.solution, &ws.residual}) a->assign(m, 0.0);
    ws.matrix.assign(m * m, 0.0), ws.inverse.assign(m * m, 0.0), ws.done.assign(m, 0);
    if (!nl.k) return;
    const std::size_t k = nl.k;
    make_law_buffers(k, layout, ws.ports);
    ws.moved.assign(capacity, 0.0);
    ws.wires.resize(n), ws.active_ports.resize(n);
    std::size_t most = 0;
    for (const int i : tensions.components) {
        const std::size_t ports = components[i].n_ports + components[i].contact.n;
        most = std::max(most, ports);
        ws.active_ports[i].reserve(ports), ws.wires[i].reserve(tensions.terms.size() + nl.all_terms.size());
    }
    ws.free.assign(most, 0.0), ws.compliance.assign(most * most, 0.0);
    ws.all.assign((m + k) * (m + k), 0.0), ws.called.assign(k * m, 0.0), ws.z.assign(k * k, 0.0);
}

// Part of a string with longitudinal motion; `c` is its component.
inline Geometric::Part load_part(const GeometricDescription::Part& d, const Component& c, bool along,
                                 const std::string& name) {
    require(d.slopes.ndim == 2, name + "slopes has 2 dimensions");
    const std::size_t n = d.slopes.shape[1], cosines = d.slopes.shape[0], p = c.n_ports, w = padded(n);
    expect(name + "reading", d.reading, {n});
    expect(name + "compliances", d.compliances, {n});
    expect(name + "kick", d.kick, {2, n});
    expect(name + "to_port", d.to_port, {p, n});
    expect(name + "from_port", d.from_port, {p, n});
    require(!c.driven && !c.contact.n && n <= std::size_t(c.n) && cosines > 0 && (along || cosines == 1),
            name + "slopes: they do not fit the component");
    Geometric::Part part;
    part.component = d.slot, part.n = int(n), part.width = int(w), part.cosines = int(cosines);
    part.cosines_width = int(padded(cosines));
    part.slopes.assign(n * part.cosines_width, 0.0), part.back.assign(cosines * w, 0.0), part.stretch.assign(w, 0.0);
    if (!along) std::copy_n(d.slopes.data, n, part.stretch.begin());
    for (std::size_t i = 0; along && i < cosines; ++i)
        for (std::size_t k = 0; k < n; ++k) {
            const double slope = d.slopes[i * n + k];
            part.slopes[k * part.cosines_width + i] = part.back[i * w + k] = slope;
            part.stretch[k] += (i == 0 ? 1.0 : 0.5) * slope * slope;
        }
    const auto rows = [&](const View& a, std::size_t count) {
        Array<double> out(count * w, 0.0);
        for (std::size_t q = 0; q < count; ++q) std::copy_n(a.data + q * n, n, out.data() + q * w);
        return out;
    };
    part.reading = rows(d.reading, 1), part.compliances = rows(d.compliances, 1), part.kick = rows(d.kick, 2);
    part.to_port = rows(d.to_port, p), part.from_port = rows(d.from_port, p);
    return part;
}

inline Geometric load_geometric(const std::vector<GeometricDescription>& strings, std::vector<Component>& components) {
    Geometric out;
    for (Component& c : components) c.geometric = false;
    for (std::size_t s = 0; s < strings.size(); ++s) {
        const GeometricDescription& d = strings[s];
        const std::string name = "geometric[" + std::to_string(s) + "].";
        require(d.parts.size() >= (d.along ? 2u : 1u), name + "parts: too few");
        Geometric::String string;
        string.scale = d.scale, string.along = d.along;
        for (std::size_t q = 0; q < d.parts.size(); ++q) {
            const auto& part = d.parts[q];
            require(part.slot >= 0 && std::size_t(part.slot) < components.size(), name + "slot: no such component");
            Component& c = components[part.slot];
            string.parts.push_back(load_part(part, c, d.along, name + "parts[" + std::to_string(q) + "]."));
            c.geometric = true;
        }
        string.order = string.parts.back().cosines - 1;
        if (d.along) std::fill(string.parts.back().stretch.begin(), string.parts.back().stretch.end(), 0.0);
        out.strings.push_back(std::move(string));
    }
    return out;
}

}  // namespace tonewood
