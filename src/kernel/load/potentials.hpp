// Potentials as loaded.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "../data/state.hpp"
#include "layout.hpp"

namespace tonewood {

// Coefficients of sums over a polarization's modes for each pair of its ports; see Potentials::One.
inline void derive_pairs(const Component& c, int at, Potentials::One& string) {
    const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
    for (int p = 0; p < c.n_ports; ++p)
        for (int q = 0; q < c.n_ports; ++q) {
            double steady = 0.0;
            auto& once = string.once[std::size_t(at + p) * string.n + at + q];
            auto& twice = string.twice[std::size_t(at + p) * string.n + at + q];
            for (int k = 0; k < c.n; ++k) {
                const double* const numbers = c.coordinates.numbers.data() + k / kPadding * step + k % kPadding;
                const double h = c.coordinates.half[k], p1 = 2 * c.coordinates.middle[c.n + k];
                const double rr = p1 * numbers[(kScaledNumbers + p) * kPadding] * numbers[(kScaledNumbers + q) * kPadding];
                once[0] += h * rr, once[1] -= h * h * rr;
                twice[0] += h * h * p1 * rr, twice[1] -= 2 * h * h * h * p1 * rr, twice[2] += h * h * h * h * p1 * rr;
                steady += 0.5 * h * p1 * rr;
            }
            if (p == q) string.steady[std::size_t(at + p)] = std::sqrt(steady);
        }
}

// Forces on the strings' ports per displacement of each, -s^T (B - B U K U^T B) s, s their shares of connections.
inline void answer_in_parts(const Solve& solve, Potentials& t) {
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
            double& to = t.onto_ports[p * t.most * t.lanes + t.ports[q].lane];
            for (const Share& s : t.ports[q].shares) to -= s.factor * blocks[p * m + s.connection];
            for (std::size_t i = 0; i < r; ++i) to += reach[q * r + i] * joined[p * r + i];
        }
}

// Numbers the potentials' components and their fixed ports, folds the answer of the linear connections to displacements of these
// into matrices, and makes the buffers of a run.
inline void make_potentials(const std::vector<Component>& components, const Solve& solve, const Layout& l, Potentials& t,
                          std::size_t capacity, const Nonlinear& nl, PotentialState& ws) {
    t.parts.clear(), t.ports.clear(), t.n_sums = 0;
    if (t.two_way.empty()) return;
    std::vector<int> place(components.size(), 0);
    for (std::size_t i = 0, ports = 0; i < components.size(); ++i) {
        place[i] = int(ports);
        if (!components[i].driven) ports += components[i].n_ports;
    }
    const std::size_t count = t.two_way.size(), n_places = l.port_rows.size(), lane = padded(count);
    for (std::size_t s = 0; s < count; ++s) {
        Potentials::One& one = t.two_way[s];
        one.root = 2 * std::sqrt(one.scale), one.highest = 0.0;
        one.first = int(t.ports.size()), one.n = 0, one.first_part = int(t.parts.size());
        for (const int i : one.components) one.n += components[i].n_ports;
        const bool modulated = one.kind == Potentials::tension;
        one.once.assign(modulated ? std::size_t(one.n) * one.n : 0, {}), one.steady.assign(one.n, 0.0);
        one.twice.assign(one.once.size(), {});
        for (const int i : one.components) {
            const Component& c = components[i];
            one.highest = std::max(one.highest, c.coordinates.largest_half);
            if (modulated) derive_pairs(c, int(t.ports.size()) - one.first, one);
            t.parts.push_back({i, int(s), int(t.ports.size()), t.n_sums});
            t.n_sums += kSharedSums + std::size_t(kPortSums) * c.n_ports;
            for (int p = 0; p < c.n_ports; ++p)
                t.ports.push_back({int(s), l.row[i] + p, l.port[i] + p, place[i] + p,
                                   (int(t.ports.size()) - one.first) * int(lane) + int(s), c.shares[p]});
        }
    }
    const std::size_t n = t.ports.size(), width = padded(n);
    t.width = int(width), t.lanes = int(lane), t.most = 0;
    for (const Potentials::One& one : t.two_way) t.most = std::max(t.most, one.n);
    const std::size_t row = std::size_t(t.most) * lane;
    t.onto_ports.assign(n * row, 0.0);
    const std::size_t of_one_matrix = l.in_parts ? 0 : n;
    t.onto_forces.assign(of_one_matrix * l.force_width, 0.0), t.onto_linear.assign(of_one_matrix * l.f_width, 0.0);
    if (l.in_parts) answer_in_parts(solve, t);
    for (std::size_t p = 0; p < of_one_matrix; ++p) {
        const std::size_t from = t.ports[p].place;
        const double *linear = l.gather.data() + ((n_places + from) * l.f_width),
                     *forces = l.direct.free.data() + from * l.force_width;
        std::copy_n(linear, l.f_width, t.onto_linear.data() + p * l.f_width);
        std::copy_n(forces, l.force_width, t.onto_forces.data() + p * l.force_width);
        for (std::size_t q = 0; q < n; ++q) t.onto_ports[p * row + t.ports[q].lane] = forces[t.ports[q].force];
    }
    t.answered = rows_in_use(t.onto_forces, l.force_width);
    const std::size_t n_sums = (t.n_sums + kPadding - 1) / kPadding * kPadding, k = nl.k;
    ws.scaled.assign(kScaledState * capacity, 0.0), ws.known.assign(capacity, 0.0);
    ws.lanes.assign(n_sums * 8, 0.0), ws.sums.assign(n_sums, 0.0);
    for (Array<double>* a :
         {&ws.psi, &ws.mean, &ws.alone, &ws.own, &ws.shift, &ws.spread, &ws.bound, &ws.over})
        a->assign(lane, 0.0);
    for (Array<double>* a : {&ws.reach, &ws.driven, &ws.answering, &ws.pulled, &ws.answered, &ws.forces, &ws.moved})
        a->assign(width, 0.0);
    ws.reach_lanes.assign(row, 0.0), ws.unit.assign(2 * lane, 0.0), ws.unit[lane] = 1.0;
    for (Array<double>* a : {&ws.matrix, &ws.upper}) a->assign(count * lane, 0.0);
    ws.linear.assign(l.f_width, 0.0), ws.y.assign(padded(n_places) + 2 * kLane, 0.0);
    ws.has_meets.assign(k, 0), ws.meets.assign(k * row, 0.0), ws.z.assign(k * k, 0.0);
    ws.gap.assign(k * lane, 0.0), ws.solved.assign(count * padded(k), 0.0), ws.row.assign(padded(k), 0.0);
}

// (count, points) cos(n theta) at the points of a string with longitudinal motion.
inline Array<double> cosines_at_points(std::size_t count, std::size_t points) {
    constexpr double kPi = 3.14159265358979323846;
    Array<double> out(count * points);
    for (std::size_t n = 0; n < count; ++n)
        for (std::size_t j = 0; j < points; ++j)
            out[n * points + j] = std::cos(kPi * double(n * (2 * j + 1) % (4 * points)) / double(2 * points));
    return out;
}

// A (n, width) matrix by blocks of at most kColumns columns, each row after row: they are read as they lie.
inline Array<double> by_columns(const Array<double>& matrix, std::size_t width) {
    Array<double> out;
    for (std::size_t first = 0, end; first < width; first = end) {
        end = first + block_columns(width - first);
        for (std::size_t row = 0; row < matrix.size(); row += width)
            out.insert(out.end(), matrix.begin() + std::ptrdiff_t(row + first), matrix.begin() + std::ptrdiff_t(row + end));
    }
    return out;
}

// The arrays of a string with longitudinal motion. Products of two cosines of the slope and one of the strain are
// integrated by as many points as that takes.
inline Stretch load_stretch(const PotentialDescription& d, const std::vector<Component>& components,
                            const std::string& name) {
    require(d.slots.size() >= 2 && d.parts.size() == d.slots.size(), name + "parts: one for each component is needed");
    Stretch out;
    out.scale = d.scale;
    const std::size_t last = d.parts.size() - 1;
    std::size_t most = 1;
    for (std::size_t q = 0; q <= last; ++q) {
        const View& slopes = d.parts[q].slopes;
        const Component& c = components[d.slots[q]];
        const std::string at = name + "parts[" + std::to_string(q) + "].";
        require(slopes.ndim == 2, at + "slopes has 2 dimensions");
        const bool moves = slopes.shape[1] > 0 || q < last;  // a plane whose modes all lie above the solved band does not
        require(!c.contact.n && moves && slopes.shape[1] <= std::size_t(c.n) && slopes.shape[0] > 0,
                at + "slopes: they do not fit the component");
        out.sizes.push_back(int(slopes.shape[1]));
        if (q < last) most = std::max(most, std::size_t(slopes.shape[0]));
    }
    const View& strain = d.parts[last].slopes;
    const std::size_t cosines = strain.shape[0], modes = strain.shape[1];
    out.order = int(cosines) - 1, out.width = int(padded(modes)), out.strain_width = int(padded(cosines));
    out.strain.assign(modes * out.strain_width, 0.0), out.back.assign(cosines * out.width, 0.0);
    for (std::size_t i = 0; i < cosines; ++i)
        for (std::size_t k = 0; k < modes; ++k)
            out.strain[k * out.strain_width + i] = out.back[i * out.width + k] = strain[i * modes + k];
    const std::size_t exact = (2 * (most - 1) + cosines - 1) / 2 + 1, points = padded(exact);
    const Array<double> all = cosines_at_points(std::max(most, cosines), exact);
    out.points = int(exact), out.width_at_points = int(points), out.weights.assign(out.strain_width, 0.0);
    out.project.assign(exact * out.strain_width, 0.0), out.spread.assign(cosines * points, 0.0);
    for (std::size_t i = 0; i < cosines; ++i) {
        out.weights[i] = out.scale * (i == 0 ? 1.0 : 0.5);
        for (std::size_t j = 0; j < exact; ++j) {
            out.project[j * out.strain_width + i] = all[i * exact + j] * (i == 0 ? 0.5 : 1.0) / double(exact);
            out.spread[i * points + j] = all[i * exact + j] * out.scale / double(exact);
        }
    }
    out.spread = by_columns(out.spread, points);
    for (std::size_t q = 0; q < last; ++q) {
        const View& slopes = d.parts[q].slopes;
        const std::size_t n = slopes.shape[1];
        Array<double> at_points(n * points, 0.0);
        for (std::size_t i = 0; i < slopes.shape[0]; ++i)
            for (std::size_t k = 0; k < n; ++k)
                for (std::size_t j = 0; j < exact; ++j)
                    at_points[k * points + j] += slopes[i * n + k] * all[i * exact + j];
        if (!out.planes.empty() && out.planes.back().count == 1 && out.planes.back().slopes == at_points)
            out.planes.back().count = 2;
        else
            out.planes.push_back({int(q), 1, int(n), int(padded(n)), std::move(at_points), {}});
    }
    for (Stretch::Planes& planes : out.planes) {
        const std::size_t wide = std::size_t(planes.width);
        planes.pulls.assign(exact * wide, 0.0);
        for (std::size_t k = 0; k < std::size_t(planes.n); ++k)
            for (std::size_t j = 0; j < exact; ++j) planes.pulls[j * wide + k] = planes.slopes[k * points + j];
        planes.slopes = by_columns(planes.slopes, points), planes.pulls = by_columns(planes.pulls, wide);
    }
    return out;
}

// The C function of a potential.
inline UserPotential load_user(const PotentialDescription& d, const std::vector<Component>& components,
                               const std::string& name) {
    require(d.function, name + "function: none is given");
    require(d.sizes.size() == d.slots.size(), name + "sizes: one for each component is needed");
    for (std::size_t q = 0; q < d.sizes.size(); ++q)
        require(d.sizes[q] >= 0 && d.sizes[q] <= components[d.slots[q]].n && !components[d.slots[q]].contact.n,
                name + "sizes: they do not fit component " + std::to_string(d.slots[q]));
    return {d.function, d.data, d.scratch, d.scale, d.sizes};
}

// A string whose longitudinal motion is driven one way.
inline PhantomString load_phantom(const PotentialDescription& d, const std::vector<Component>& components,
                                  const std::string& name) {
    require(d.target >= 0 && std::size_t(d.target) < components.size() && !components[d.target].driven &&
                !components[d.target].by_sample(),
            name + "target: no force can act on component " + std::to_string(d.target));
    require(d.steps.ndim == 2 && d.steps.shape[0] >= 1 && d.steps.shape[0] <= kPhantomModes,
            name + "steps: 1 to " + std::to_string(kPhantomModes) + " modes are allowed");
    require(d.parts.size() == d.slots.size(), name + "parts: one for each component is needed");
    const std::size_t order = d.steps.shape[0];
    expect(name + "steps", d.steps, {order, 6});
    expect(name + "vector", d.vector, {2, std::size_t(components[d.target].n)});
    require(std::all_of(d.vector.data, d.vector.data + d.vector.size(), [](double x) { return std::isfinite(x); }),
            name + "vector: its numbers must be finite");
    PhantomString out;
    out.at = d.at, out.target = d.target, out.order = int(order), out.scale = d.scale;
    out.steps.assign(6 * kPhantomModes, 0.0);
    for (std::size_t m = 0; m < order; ++m)
        for (std::size_t i = 0; i < 6; ++i) out.steps[i * kPhantomModes + m] = d.steps[6 * m + i];
    for (std::size_t q = 0; q < d.parts.size(); ++q) {
        const auto& p = d.parts[q];
        const int slot = d.slots[q];
        require(p.weights.ndim == 2, name + "weights: two axes are needed");
        const std::size_t n = p.weights.shape[1];  // 0 where every mode of the string lies above the solved band
        require(n <= std::size_t(components[slot].n) && !components[slot].driven && !components[slot].by_sample(),
                name + "parts: one does not fit component " + std::to_string(slot));
        expect(name + "weights", p.weights, {order + 1, n});
        expect(name + "mirrored", p.mirrored, {order + 1, order});
        PhantomString::Part part;
        part.slot = slot, part.n = int(n);
        part.weights.assign(n * (order + 1), 0.0), part.mirrored.assign((order + 1) * kPhantomModes / 2, 0.0);
        for (std::size_t m = 0; m <= order; ++m) {
            for (std::size_t k = 0; k < n; ++k) part.weights[k * (order + 1) + m] = p.weights.data[m * n + k];
            for (std::size_t k = 0; k < m; ++k)  // both orders of a pair
                part.mirrored[m * kPhantomModes / 2 + std::min(k, m - 1 - k)] += p.mirrored.data[m * order + k];
        }
        out.parts.push_back(std::move(part));
    }
    return out;
}

// Joins the state vectors (2, n) of 1 N of each string: strings on one bridge share few independent ones. Gram-Schmidt,
// the largest remainder first, until no number is further than 1e-14 of the largest in its place from its string's.
inline std::vector<DrivenForces> join_forces(const std::vector<PhantomString>& strings,
                                             std::vector<Array<double>> vectors) {
    std::vector<DrivenForces> out;
    for (std::size_t first = 0; first < strings.size(); ++first) {
        DrivenForces to;
        to.target = strings[first].target;
        if (std::any_of(out.begin(), out.end(), [&](const auto& other) { return other.target == to.target; })) continue;
        std::vector<std::size_t> own;
        for (std::size_t q = first; q < strings.size(); ++q)
            if (strings[q].target == to.target) own.push_back(q);
        Array<double> largest(vectors[first].size());
        const auto scale = [&](Array<double>& a, bool back) {
            for (std::size_t k = 0; k < a.size(); ++k)
                a[k] = back ? a[k] * largest[k] : largest[k] > 0.0 ? a[k] / largest[k] : 0.0;
        };
        for (const std::size_t q : own)
            for (std::size_t k = 0; k < largest.size(); ++k)
                largest[k] = std::max(largest[k], std::abs(vectors[q][k]));
        for (const std::size_t q : own) scale(vectors[q], false);
        while (to.count < own.size()) {
            const auto product = [&](std::size_t q, const Array<double>& a) {
                return std::inner_product(a.begin(), a.end(), vectors[q].begin(), 0.0);
            };
            double left = 0.0, most = 0.0;
            Array<double> next;
            for (const std::size_t q : own) {
                for (const double x : vectors[q]) left = std::max(left, std::abs(x));
                if (const double size = product(q, vectors[q]); size > most) most = size, next = vectors[q];
            }
            if (left <= 1e-14) break;
            for (double& x : next) x /= std::sqrt(most);
            to.shares.resize(++to.count * strings.size(), 0.0);
            for (const std::size_t q : own) {
                const double share = to.shares[(to.count - 1) * strings.size() + q] = product(q, next);
                for (std::size_t k = 0; k < next.size(); ++k) vectors[q][k] -= share * next[k];
            }
            scale(next, true);
            to.vectors.insert(to.vectors.end(), next.begin(), next.end());
        }
        out.push_back(std::move(to));
    }
    return out;
}

// Marks the components of potentials, and checks what all kinds share.
inline void mark_potentials(const std::vector<PotentialDescription>& all, std::vector<Component>& components) {
    for (Component& c : components) c.modulated = c.coupled = false;
    for (std::size_t s = 0; s < all.size(); ++s) {
        const PotentialDescription& d = all[s];
        const std::string name = "potentials[" + std::to_string(s) + "]";
        require(d.kind >= 0 && d.kind < Potentials::n_kinds, name + ": no such kind");
        require(d.at <= kPhantomMemory * components.size(), name + ".at: a state of so many numbers is not needed");
        require(!d.slots.empty(), name + ": no components");
        require(s == 0 || all[s - 1].kind <= d.kind, name + ": potentials of a kind stand together");
        for (const int i : d.slots) {
            require(i >= 0 && std::size_t(i) < components.size(), name + ": no component " + std::to_string(i));
            Component& c = components[i];
            if (d.kind == Potentials::phantom) continue;
            require(!c.coordinates.reading.empty(),
                    name + ": component " + std::to_string(i) + " was loaded without `reading`");
            require(!c.by_sample(), name + ": component " + std::to_string(i) + " belongs to another potential");
            (d.kind == Potentials::tension ? c.modulated : c.coupled) = true;
        }
    }
}

}  // namespace tonewood
