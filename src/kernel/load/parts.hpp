// Linear connections in parts: checked, and as sparse products between ports, connections and points of the hub.
#pragma once

#include <algorithm>
#include <map>
#include <string>

#include "../data/layout.hpp"
#include "description.hpp"

namespace tonewood {

// Takes the inverse in parts; whether it was another one.
inline bool load_parts(const LinearDescription& d, Solve& s, const std::vector<Component>& components) {
    const std::size_t m = d.gamma.size(), r = d.hub.ports.size();
    std::vector<Entry> blocks;
    std::vector<char> seen(m, 0);
    for (const auto& part : d.parts) {
        require(part.places.ndim == 2, "linear.parts.places has 2 dimensions");
        const std::size_t b = part.places.shape[0], n = part.places.shape[1];
        expect("linear.parts.inverses", part.inverses, {b, n, n});
        const auto place = [&](std::size_t at) {
            const double x = part.places[at];
            require(x >= 0 && x < double(m), "linear.parts.places: there is no such connection");
            return int(x);
        };
        for (std::size_t i = 0; i < b * n; ++i) {
            require(!seen[place(i)], "linear.parts.places: a connection is in two parts");
            seen[place(i)] = 1;
            for (std::size_t j = 0; j < n; ++j)
                blocks.push_back({place(i), place(i / n * n + j), part.inverses[i * n + j]});
        }
    }
    require(d.parts.empty() || std::count(seen.begin(), seen.end(), 1) == std::ptrdiff_t(m),
            "linear.parts.places: a connection is in no part");
    Solve::Hub hub;
    if (d.hub.slot >= 0) {
        require(!d.parts.empty() && std::size_t(d.hub.slot) < components.size(),
                "linear.hub: there is no such component, or no parts");
        const Component& c = components[d.hub.slot];
        require(d.hub.span.ndim == 2 && d.hub.point.size() == m && r > 0,
                "linear.hub.span has 2 dimensions, point one number a connection, ports one at least");
        expect("linear.hub.factor", d.hub.factor, {m});
        expect("linear.hub.span", d.hub.span, {d.hub.span.shape[0], r});
        expect("linear.hub.joined", d.hub.joined, {r, r});
        for (const int point : d.hub.point)
            require(point >= -1 && point < int(d.hub.span.shape[0]), "linear.hub.point: there is no such point");
        for (const int port : d.hub.ports)
            require(port >= 0 && port < c.n_ports && !c.driven, "linear.hub.ports: there is no such port");
        for (const auto& shares : c.shares)
            require(shares.empty(), "linear.hub: its component has an incidence as well");
        hub = {d.hub.slot, d.hub.ports, d.hub.point, d.hub.factor.copy(), d.hub.span.copy(), d.hub.joined.copy()};
    }
    const bool changed = s.in_parts != !d.parts.empty() || blocks != s.blocks || !(hub == s.hub);
    s.in_parts = !d.parts.empty(), s.blocks = std::move(blocks), s.hub = std::move(hub);
    return changed;
}

// Sorts entries by rows; `columns` numbers are multiplied.
inline SparseRows sparse_rows(std::size_t rows, std::size_t columns, const std::vector<Entry>& entries) {
    SparseRows out;
    out.width = int(padded(rows));
    std::vector<int> count(out.width, 0);
    for (const Entry& e : entries) {
        if (e.value == 0.0) continue;
        const int l = count[e.row]++;
        if (l >= SparseRows::kLayers) {
            out.rest.push_back(e);
            continue;
        }
        if (l == int(out.layers.size())) {
            out.layers.emplace_back();
            out.layers.back().column.assign(out.width, 0), out.layers.back().value.assign(out.width, 0.0);
        }
        out.layers[l].column[e.row] = e.column, out.layers[l].value[e.row] = e.value;
    }
    for (auto& layer : out.layers) {
        int first = -1, last = 0;
        for (int i = 0; i < out.width; ++i) {
            if (layer.value[i] == 0.0) continue;
            if (first < 0) first = i, layer.shift = layer.column[i] - i;
            layer.in_order = layer.in_order && layer.column[i] == i + layer.shift;
            last = i;
        }
        layer.first = first / kLane * kLane, layer.end = int(padded(last + 1));
        // whole vectors are read of the factor, which is padded
        layer.in_order = layer.in_order && layer.first + layer.shift >= 0 &&
                         std::size_t(layer.end + layer.shift) <= padded(columns) + (columns > 0 ? kLane : 0);
    }
    return out;
}

// Components that no linear connection joins to another one or pulls on at rest; known only of an inverse in parts.
inline std::vector<char> without_neighbours(const std::vector<Component>& components, const Solve& solve) {
    std::vector<char> out(components.size(), 0);
    std::vector<int> owner(solve.m, -1);
    for (std::size_t i = 0; i < components.size(); ++i) {
        out[i] = !components[i].driven && (solve.in_parts || components[i].n_ports == 0) && int(i) != solve.hub.slot;
        if (components[i].driven) continue;
        for (const auto& shares : components[i].shares)
            for (const Share& s : shares) {
                int& of = owner[s.connection];
                if (of >= 0 && of != int(i)) out[i] = out[of] = 0;
                of = int(i);
                if (solve.constant[s.connection] != 0.0 || (solve.hub.slot >= 0 && solve.hub.point[s.connection] >= 0))
                    out[i] = 0;
            }
    }
    for (const Entry& e : solve.blocks)
        if (owner[e.row] != owner[e.column])
            for (const int i : {owner[e.row], owner[e.column]})
                if (i >= 0) out[i] = 0;
    return out;
}

inline Parts make_parts(const std::vector<Component>& components, const Solve& solve, const Layout& l) {
    Parts out;
    const Solve::Hub& hub = solve.hub;
    const int m = out.m = solve.m, r = out.r = int(hub.ports.size()),
              points = out.points = r ? int(hub.span.size()) / r : 0;
    out.r_width = int(padded(r)), out.point_width = int(padded(points));
    std::vector<Entry> gaps, forces;
    int place = 0, n_ports = 0;
    for (std::size_t i = 0; i < components.size(); ++i) {
        const Component& c = components[i];
        if (int(i) == hub.slot)
            for (const int port : hub.ports) out.rows.push_back(place + port), out.to.push_back(l.port[i] + port);
        for (int p = 0; p < c.n_ports; ++p) {
            for (const Share& s : c.shares[p]) {
                if (!c.driven) gaps.push_back({s.connection, place + p, s.factor});
                forces.push_back({l.port[i] + p, s.connection, s.factor});
            }
            n_ports = std::max(n_ports, l.port[i] + p + 1);
        }
        if (!c.driven) place += c.n_ports;
    }
    out.gaps = sparse_rows(m, place, gaps), out.forces = sparse_rows(n_ports, m, forces);
    out.blocks = sparse_rows(m, m, solve.blocks);
    out.gamma = solve.gamma, out.gamma.resize(padded(m), 0.0);
    if (!r) return out;
    std::map<std::pair<int, int>, double> reach;
    for (const Entry& e : solve.blocks)
        if (const int point = hub.point[e.column]; point >= 0) reach[{e.row, point}] += e.value * hub.factor[e.column];
    std::vector<Entry> across, back, onto, old;
    out.hub_gamma = -1.0;
    for (int j = 0; j < m; ++j)
        if (hub.point[j] >= 0) out.hub_gamma = std::max(out.hub_gamma, solve.gamma[j]);
    for (const auto& [at, value] : reach)
        across.push_back({at.first, at.second, value}), back.push_back({at.second, at.first, value});
    out.constant.assign(out.r_width, 0.0), out.joined.assign(std::size_t(r) * out.r_width, 0.0);
    for (int j = 0; j < m; ++j) {
        if (hub.point[j] < 0) continue;
        onto.push_back({hub.point[j], j, hub.factor[j]});
        for (int i = 0; i < r; ++i) {
            const double moved = hub.span[std::size_t(hub.point[j]) * r + i] * hub.factor[j];
            out.constant[i] += moved * solve.constant[j];
            if (solve.gamma[j] != out.hub_gamma && moved != 0.0)
                old.push_back({j, i, (solve.gamma[j] - out.hub_gamma) * moved});
        }
    }
    out.reach = sparse_rows(m, points, across), out.load = sparse_rows(points, m, back);
    out.onto_points = sparse_rows(points, m, onto), out.old = sparse_rows(m, r, old);
    for (int i = 0; i < r; ++i)
        for (int j = 0; j < r; ++j) out.joined[std::size_t(j) * out.r_width + i] = hub.joined[std::size_t(i) * r + j];
    out.own_motions = points == r;
    for (int i = 0; i < r && out.own_motions; ++i)
        for (int j = 0; j < r; ++j)
            out.own_motions = out.own_motions && hub.span[std::size_t(i) * r + j] == double(i == j);
    if (out.own_motions) {
        std::map<std::pair<int, int>, double> between;
        for (const Entry& e : across)
            if (const int p = hub.point[e.row]; p >= 0) between[{p, e.column}] += hub.factor[e.row] * e.value;
        std::vector<Entry> entries;
        for (const auto& [at, value] : between) entries.push_back({at.first, at.second, value});
        out.own_stiffness = sparse_rows(r, r, entries);
        return out;
    }
    out.span.assign(std::size_t(points) * out.r_width, 0.0), out.motion.assign(std::size_t(r) * out.point_width, 0.0);
    for (int p = 0; p < points; ++p)
        for (int i = 0; i < r; ++i)
            out.span[std::size_t(p) * out.r_width + i] = out.motion[std::size_t(i) * out.point_width + p] =
                hub.span[std::size_t(p) * r + i];
    out.stiffness.assign(std::size_t(r) * out.r_width, 0.0);
    // H = P^T (Q^T B Q) P
    Array<double> half(std::size_t(points) * r, 0.0);
    for (const Entry& e : across)
        if (const int p = hub.point[e.row]; p >= 0)
            for (int i = 0; i < r; ++i)
                half[std::size_t(p) * r + i] += hub.factor[e.row] * e.value * hub.span[std::size_t(e.column) * r + i];
    for (int p = 0; p < points; ++p)
        for (int i = 0; i < r; ++i)
            for (int j = 0; j < r; ++j)
                out.stiffness[std::size_t(i) * out.r_width + j] +=
                    hub.span[std::size_t(p) * r + i] * half[std::size_t(p) * r + j];
    return out;
}

}  // namespace tonewood
