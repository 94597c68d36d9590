// What is made of nonlinear connections when they are loaded: bounds, groups, and the buffers of a run.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "model.hpp"

namespace tonewood {
namespace {

// Bounds on the rows of guarded ports throughout a block. A mode's numbers (u, v) are measured by its size
// hypot(u, s v); s makes the size of a turning mode stand still, and that of a drifting one the way it drifts.
void derive_bounds(Component& c, const double* e, const double* rows) {
    Guarded& guarded = c.guarded;
    const std::size_t n = c.n, n_guarded = guarded.n;
    guarded.norm.assign(2 * n, 0.0), guarded.size.assign(n, 0.0);
    guarded.middle.assign(2 * n_guarded * n, 0.0), guarded.spread.assign(n_guarded * n, 0.0);
    guarded.peak.assign(n_guarded, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double e00 = e[k], e01 = e[n + k], e10 = e[2 * n + k], e11 = e[3 * n + k];
        const double still = std::abs(e10) > 0.0 ? std::sqrt(std::abs(e01 / e10)) : 1.0;
        const double s = std::abs(e01) > 0.0 ? std::min(still, kBlock * std::abs(e01)) : 1.0;
        const double stiffness = std::max((1 - e00) * (1 - e11) - e01 * e10, 1e-8);
        guarded.size[k] = s, guarded.norm[k] = stiffness, guarded.norm[n + k] = stiffness * s * s;
        for (std::size_t g = 0; g < n_guarded; ++g) {
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
            guarded.peak[g] += all / stiffness;
            if (far < all) {
                guarded.middle[2 * g * n + k] = a_mid;
                guarded.middle[(2 * g + 1) * n + k] = b_mid;
            }
            guarded.spread[g * n + k] = std::sqrt(std::min(far, all));
        }
    }
    for (double& peak : guarded.peak) peak = std::sqrt(peak);
}

// The energy of a woven string of one port, if all its modes oscillate, none grows, and shapes are real: a force at the
// port changes u' but not u. Nothing is set otherwise.
void derive_energy(Component& c) {
    Guarded& g = c.guarded;
    const std::size_t n = c.n, count = g.n;
    g.energy.clear(), g.swing.assign(count, 0.0), g.lean.assign(count, 0.0);
    if (c.woven.chunks.empty() || c.n_ports != 1 || c.n_rows != 1) return;
    struct Mode {  // u = x rx + y ry, u' / w = x vx + y vy
        double compliance = 0, rx, ry, vx, vy, area;
        // a guarded row as a u + b u' / w
        double a(double x, double y) const { return (x * vy - y * vx) / area; }
        double b(double x, double y) const { return (rx * y - ry * x) / area; }
    };
    std::vector<Mode> modes(n);
    Array<double> weights(2 * n, 0.0);
    double whole = 0.0;
    for (const auto& chunk : c.woven.chunks)
        for (std::size_t k = chunk.first; k < std::size_t(chunk.first + chunk.count); ++k) {
            const double a = c.e[k], b = c.e[n + k], d = c.e[2 * n + k], e = c.e[3 * n + k];
            const double rx = c.rows[k], ry = c.rows[n + k], wx = c.w[k], wy = c.w[n + k];
            const double mean = 0.5 * (a + e), det = a * e - b * d, bent = 0.25 * (a - e) * (a - e) + b * d;
            if (!(bent < 0.0) || !(det > 0.0) || det > 1.0 + 1e-12) return;
            // log E = decay + turn (E - mean), and its determinant w^2, per sample
            const double angle = std::atan2(std::sqrt(-bent), mean), decay = 0.5 * std::log(det);
            const double turn = angle / std::sqrt(-bent), w = std::hypot(angle, decay);
            const double l00 = decay + turn * (a - mean), l01 = turn * b, l10 = turn * d, l11 = decay + turn * (e - mean);
            Mode& mode = modes[k];
            mode.rx = rx, mode.ry = ry, mode.vx = (rx * l00 + ry * l10) / w, mode.vy = (rx * l01 + ry * l11) / w;
            mode.area = rx * mode.vy - ry * mode.vx;
            const double kappa = (1 - a) * (1 - e) - b * d;
            const double sx = ((1 - e) * wx + b * wy) / kappa, sy = (d * wx + (1 - a) * wy) / kappa;  // at rest per newton
            // x' per newton is -log E times that
            const double kick_x = l00 * sx + l01 * sy, kick_y = l10 * sx + l11 * sy;
            const double kick = rx * kick_x + ry * kick_y, size = std::hypot(rx, ry) * std::hypot(kick_x, kick_y);
            mode.compliance = rx * sx + ry * sy;
            if (!(mode.compliance > 0.0) || !(std::abs(mode.area) > 0.0) || !(std::abs(kick) <= 1e-9 * size)) return;
            const double half = 0.5 / mode.compliance;
            // 2 |x y| <= r x^2 + y^2 / r instead of the product: of modes of little damping it is next to nothing
            const double xx = rx * rx + mode.vx * mode.vx, yy = ry * ry + mode.vy * mode.vy;
            const double both = std::abs(rx * ry + mode.vx * mode.vy), r = std::sqrt(xx / yy);
            weights[k] = half * (xx + both * r), weights[n + k] = half * (yy + both / r);
            whole += mode.compliance;
        }
    if (!(whole > 0.0)) return;
    for (std::size_t r = 0; r < count; ++r) {
        const double *x = g.rows.data() + 2 * r * n, *y = x + n;
        double along = 0.0, swing = 0.0;
        for (std::size_t k = 0; k < n; ++k) {
            if (modes[k].compliance > 0.0)
                along += modes[k].compliance * modes[k].a(x[k], y[k]);
            else if (x[k] != 0.0 || y[k] != 0.0)
                return;
        }
        const double lean = along / whole;
        for (std::size_t k = 0; k < n; ++k) {
            if (!(modes[k].compliance > 0.0)) continue;
            const double a = modes[k].a(x[k], y[k]) - lean, b = modes[k].b(x[k], y[k]);
            swing += 2 * modes[k].compliance * (a * a + b * b);
        }
        g.lean[r] = std::abs(lean), g.swing[r] = std::sqrt(swing);
    }
    g.energy = std::move(weights);
}

// Farthest that the forces of a rising tension move guarded rows of a string in the rest of a block, per
// T/2 sqrt(sum a (y+ + y)^2): they are -T/2 a (y+ + y) on each mode.
void derive_pulled(Component& c) {
    Guarded& g = c.guarded;
    const Stretched& s = c.stretched;
    const std::size_t n = c.n;
    g.pulled.assign(g.n, 0.0);
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
        g.pulled[r] = std::sqrt(*std::max_element(most, most + kBlock));
    }
}


// Makes what Taut reads of a component, from its matrices e (4, n) and its gain (2, n).
void derive_taut(Component& c, const double* e, const double* gain) {
    Stretched& s = c.stretched;
    const std::size_t n = c.n, p = c.n_ports, step = kTautNumbers + p;
    s.taut.assign(n * step, 0.0), s.doors.assign(8 * n, 0.0);
    for (std::size_t k = 0; k < n; ++k) {
        const double g = gain[k], e00 = e[k], e01 = e[n + k], e10 = e[2 * n + k], e11 = e[3 * n + k];
        if (g == 0.0 && e00 == 0.0) continue;  // padding
        if (!(g > 0.0) || e01 == 0.0) throw std::invalid_argument("a mode of a stretched string does not yield to force");
        const double root = std::sqrt(g), det = e00 * e11 - e01 * e10, tilt = gain[n + k] / g;
        double* const to = s.taut.data() + (k / kPadding * kPadding * step + k % kPadding);
        const double numbers[kTautNumbers] = {s.half[k], det, (1 - e00) * (1 - e11) - e01 * e10,
                                              e01 * tilt - e11 + det};
        for (int i = 0; i < kTautNumbers; ++i) to[i * kPadding] = numbers[i];
        for (std::size_t q = 0; q < p; ++q) to[(kTautNumbers + q) * kPadding] = c.rows[2 * q * n + k] * root;
        const double doors[8] = {1 / root, (e00 - 1) / root, e01 / root,                 // in
                                 root, (1 - e00) * root / e01, root / e01,               // out
                                 (det - e11) / root, e01 / root};                        // of known inputs to v
        for (int i = 0; i < 8; ++i) s.doors[i * n + k] = doors[i];
    }
}

// (all ports, all ports), fixed ones first: the farthest a port moves in a block per force on each.
Array<double> reach_of(const Component& c) {
    const Guarded& g = c.guarded;
    const std::size_t all = c.n_ports + g.n, fixed = c.n_ports, n_rows = c.n_rows, n = g.n;
    Array<double> reach(all * all, 0.0);
    const auto take = [&](std::size_t row, std::size_t port, double h) {
        reach[row * all + port] = std::max(reach[row * all + port], std::abs(h));
    };
    for (std::size_t k = 0; k < kBlock; ++k) {
        for (std::size_t p = 0; p < fixed; ++p) {
            for (std::size_t r = 0; r < fixed; ++r) take(r, p, c.history[(k * fixed + p) * n_rows + r]);
            for (std::size_t r = 0; r < n; ++r) take(fixed + r, p, g.from_fixed[(p * n + r) * kBlock + k]);
        }
        for (std::size_t p = 0; p < n; ++p) {
            for (std::size_t r = 0; r < fixed; ++r) take(r, fixed + p, g.on_rows[(p * kBlock + k) * n_rows + r]);
            for (std::size_t r = 0; r < n; ++r) take(fixed + r, fixed + p, g.from_guarded[(p * n + r) * kBlock + k]);
        }
    }
    return reach;
}

// Sorts terms by connection, and joins the components of guarded contacts to groups: within one, forces use up one
// another's slack.
void arrange(std::vector<Component>& components, const Layout& layout, Nonlinear& nl) {
    const int n = int(components.size());
    nl.terms.assign(nl.k, {}), nl.driven.assign(nl.k, {}), nl.guarded.assign(nl.k, 0);
    nl.groups.clear(), nl.group_of.assign(n, -1), nl.first.clear();
    nl.group_of_law.assign(nl.k, -1), nl.worth.assign(layout.force_width, 0.0);
    nl.in_series.assign(nl.n_series, {});
    for (int j = 0; j < nl.k; ++j)
        if (nl.series[j] >= 0) nl.in_series[nl.series[j]].push_back(j);
    nl.n_guarded = 0;
    for (const Component& c : components) nl.first.push_back(nl.n_guarded), nl.n_guarded += c.guarded.n;
    for (const Nonlinear::Term& t : nl.all_terms) {
        const Component& c = components[t.component];
        if (t.port >= (t.guarded ? c.guarded.n : c.n_ports) || (t.guarded && nl.laws[t.connection].kind != Law::contact))
            throw std::invalid_argument("a nonlinear connection does not fit the ports");
        (c.driven ? nl.driven : nl.terms)[t.connection].push_back(t);
        nl.guarded[t.connection] |= t.guarded;
    }
    // the lines tell nothing of a tense string's fixed ports beforehand
    for (const Nonlinear::Term& t : nl.all_terms)
        if (!t.guarded && (components[t.component].stretched.on || components[t.component].geometric))
            nl.guarded[t.connection] = 0;
    // a contact under which nothing moves, behind the stop of a string, is in no group
    const auto is_idle = [&](int j) {
        for (const Nonlinear::Term& t : nl.terms[j])
            if (!t.guarded || components[t.component].guarded.peak[t.port] > 0.0) return false;
        return nl.laws[j].offset <= 0.0 && nl.series[j] < 0;
    };
    for (int j = 0; j < nl.k; ++j) {
        if (!nl.guarded[j] || is_idle(j)) continue;
        int to = int(nl.groups.size());
        for (const Nonlinear::Term& t : nl.terms[j])
            if (nl.group_of[t.component] >= 0) to = std::min(to, nl.group_of[t.component]);
        if (to == int(nl.groups.size())) nl.groups.emplace_back();
        for (const Nonlinear::Term& t : nl.terms[j]) {
            const int from = nl.group_of[t.component];
            if (from == to) continue;
            if (from < 0) {
                nl.group_of[t.component] = to;
                nl.groups[to].components.push_back(t.component);
                continue;
            }
            Nonlinear::Group &gone = nl.groups[from], &stays = nl.groups[to];
            for (const int i : gone.components) nl.group_of[i] = to, stays.components.push_back(i);
            stays.contacts.insert(stays.contacts.end(), gone.contacts.begin(), gone.contacts.end());
            gone = {};
        }
        nl.groups[to].contacts.push_back(j);
    }
    std::erase_if(nl.groups, [](const Nonlinear::Group& g) { return g.contacts.empty(); });
    for (std::size_t g = 0; g < nl.groups.size(); ++g) {
        std::sort(nl.groups[g].contacts.begin(), nl.groups[g].contacts.end());
        for (const int i : nl.groups[g].components) {
            nl.group_of[i] = int(g);
            if (components[i].guarded.reach.empty()) components[i].guarded.reach = reach_of(components[i]);
        }
        Nonlinear::Group& group = nl.groups[g];
        const std::size_t n_parts = group.components.size();
        group.simple = true;
        group.tightest.assign(n_parts, 0.0), group.pull_worth = group.tightest, group.worth.assign(n_parts, {});
        std::size_t n_ports = 0;
        for (std::size_t q = 0; q < n_parts; ++q) {
            group.worth[q].assign(components[group.components[q]].n_ports, 0.0);
            n_ports += group.worth[q].size();
        }
        for (const int j : group.contacts) {
            const double room = -nl.laws[j].offset;
            nl.group_of_law[j] = int(g);
            group.simple = group.simple && room > 0.0;
            for (const Nonlinear::Term& t : nl.terms[j]) {
                group.simple = group.simple && t.guarded;
                if (!group.simple) break;
                const auto& parts = group.components;
                const std::size_t q = std::find(parts.begin(), parts.end(), t.component) - parts.begin();
                const Component& c = components[t.component];
                const double size = std::abs(t.factor), of_slack = size / ((1 - kQuiet) * room);
                group.tightest[q] = std::max(group.tightest[q], size * c.guarded.peak[t.port] / room);
                const double* reach =
                    c.guarded.reach.data() + (std::size_t(c.n_ports + t.port) * (c.n_ports + c.guarded.n));
                for (int p = 0; p < c.n_ports; ++p)
                    group.worth[q][p] = std::max(group.worth[q][p], of_slack * reach[p]);
                if (c.stretched.on)
                    group.pull_worth[q] = std::max(group.pull_worth[q], of_slack * c.guarded.pulled[t.port]);
            }
        }
        group.calm = group.simple;
        for (const int i : group.components)
            group.calm = group.calm && !components[i].guarded.energy.empty() && !components[i].geometric;
        if (group.calm) {
            group.strain.assign(n_parts, 0.0), group.sway.assign(n_parts, std::numeric_limits<double>::infinity());
            for (const int j : group.contacts)
                for (const Nonlinear::Term& t : nl.terms[j]) {
                    const auto& parts = group.components;
                    const std::size_t q = std::find(parts.begin(), parts.end(), t.component) - parts.begin();
                    const Guarded& g = components[t.component].guarded;
                    const double per = std::abs(t.factor) / -nl.laws[j].offset;
                    group.strain[q] = std::max(group.strain[q], per * g.swing[t.port] / (1 - kSway));
                    if (per * g.lean[t.port] > 0.0)
                        group.sway[q] = std::min(group.sway[q], kSway / (per * g.lean[t.port] * double(n_parts)));
                }
            for (const double strain : group.strain) group.calm = group.calm && strain > 0.0;
        }
        for (std::size_t q = 0; q < n_parts && group.simple; ++q)
            for (std::size_t p = 0; p < group.worth[q].size(); ++p)
                nl.worth[layout.port[group.components[q]] + p] = group.worth[q][p] * double(n_ports);
    }
}

// The fixed ports of stretched components, and what a displacement of one calls up in the linear connections.
void arrange_ports(const std::vector<Component>& components, const Layout& l, const Tensions& tensions,
                   TensePorts& to) {
    const auto padded = [](std::size_t n) { return (n + kLane - 1) / kLane * kLane; };
    to = TensePorts{};
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
        to.most[s] = 1e-300, to.high[s] = 0.0;  // its cell is still to be entered
        for (std::size_t c = 0; c < string.components.size(); ++c) {
            const int i = string.components[c];
            std::size_t port = c * to.most_ports * strings + s;
            to.first[i] = int(port), to.string_of[i] = int(s);
            to.own[i] = kSharedSums * strings + port;
            to.most[s] = std::max(to.most[s], components[i].stretched.most_half);
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
    for (Array<double>* a : {&to.alone, &to.moved, &to.force, &to.next, &to.wrong, &to.base, &to.fixed})
        a->assign(width, 0.0);
    for (Array<double>* a : {&to.change_at, &to.slope_at, &to.bend_at, &to.change, &to.slope}) a->assign(to.pair_width, 0.0);
    to.onto_ports.assign(n * width, 0.0);
    to.inverse.assign(n * width, 0.0), to.pivots.assign(n, 0);
    to.onto_linear.assign(n * l.f_width, 0.0), to.onto_forces.assign(n * l.force_width, 0.0);
    for (const int p : to.real) {
        const std::size_t from = to.ports[p].place;
        const double *linear = l.pull.data() + ((n_places + from) * l.f_width), *forces = l.direct.data() + from * l.force_width;
        std::copy_n(linear, l.f_width, to.onto_linear.data() + std::size_t(p) * l.f_width);
        std::copy_n(forces, l.force_width, to.onto_forces.data() + std::size_t(p) * l.force_width);
        for (const int q : to.real) to.onto_ports[std::size_t(p) * width + q] = forces[to.ports[q].force];
    }
}

// Room for how k laws see and push fixed ports of stretched components (tense_contacts.hpp).
inline void arrange_laws(std::size_t k, const Layout& l, TensePorts& to) {
    const std::size_t n = to.ports.size(), width = to.width, wide = (k + kLane - 1) / kLane * kLane;
    to.known.assign(k, 0), to.law_forces.assign(l.force_width, 0.0);
    for (Array<double>* a : {&to.meets, &to.law_ports, &to.active_ports}) a->assign(k * width, 0.0);
    for (Array<double>* a : {&to.active_meets, &to.caught}) a->assign(n * wide, 0.0);
    for (Array<double>* a : {&to.law_slope, &to.given, &to.active_free, &to.active_force}) a->assign(wide, 0.0);
    to.law_free.assign(k, 0.0), to.sum.assign(width, 0.0), to.answers.assign(k * wide, 0.0);
    to.onto_with_laws = to.onto_ports, to.fixed_with_laws.assign(width, 0.0), to.folded = false;
    to.active.clear(), to.active.reserve(k);
}

// Which linear connections see stretched strings, and how.
void arrange(std::vector<Component>& components, const Solve& solve, const Layout& layout, Tensions& tensions,
             std::size_t capacity, const Nonlinear& nl, TensionSpace& ws) {
    const std::size_t m = solve.m, n = components.size();
    tensions.components.clear(), tensions.terms.clear(), tensions.pairs.clear();
    for (Component& c : components) c.stretched.on = false;
    for (const auto& string : tensions.strings)
        for (const int i : string.components) {
            if (components[i].stretched.a.empty()) throw std::invalid_argument("a string has no weights for its tension");
            components[i].stretched.on = true;
            tensions.components.push_back(i);
        }
    if (tensions.strings.empty()) return;
    if (tensions.matrix.size() != m * m || tensions.offset.size() != m)
        throw std::invalid_argument("the matrix of the connections has the wrong shape");
    for (std::size_t i = 0; i < n; ++i) {
        const Component& c = components[i];
        if (c.driven) continue;
        const std::size_t first = tensions.terms.size();
        for (int p = 0; p < c.n_ports; ++p)
            for (const Share& s : c.shares[p]) tensions.terms.push_back({s.connection, int(i), p, s.factor});
        if (!c.stretched.on) continue;
        for (std::size_t s = first; s < tensions.terms.size(); ++s)
            for (std::size_t t = first; t < tensions.terms.size(); ++t) {
                const auto &to = tensions.terms[s], &from = tensions.terms[t];
                const int p = std::min(to.port, from.port), q = std::max(to.port, from.port);
                tensions.pairs.push_back({int(i), p * c.n_ports - p * (p - 1) / 2 + q - p, to.connection,
                                          from.connection, to.factor * from.factor,
                                          c.history[std::size_t(q) * c.n_rows + p]});
            }
    }
    for (Array<double>* a : {&ws.u, &ws.y, &ws.yields}) a->assign(capacity, 0.0);
    ws.taut.assign(kTautState * capacity, 0.0);
    arrange_ports(components, layout, tensions, ws.ports);
    for (Array<double>* a : {&ws.stretch, &ws.past, &ws.tension, &ws.used, &ws.at, &ws.after, &ws.pushed, &ws.sharp, &ws.far,
                             &ws.last_tension, &ws.last_excess, &ws.means[0], &ws.means[1], &ws.means[2]})
        a->assign(ws.ports.strings, 0.0);
    for (Array<double>* a : {&ws.fixed, &ws.right, &ws.scale, &ws.solution, &ws.wrong}) a->assign(m, 0.0);
    ws.matrix.assign(m * m, 0.0), ws.inverse.assign(m * m, 0.0), ws.done.assign(m, 0);
    if (!nl.k) return;
    const std::size_t k = nl.k;
    arrange_laws(k, layout, ws.ports);
    ws.moved.assign(capacity, 0.0);
    ws.wires.resize(n), ws.active_ports.resize(n);
    std::size_t most = 0;
    for (const int i : tensions.components) {
        const std::size_t ports = components[i].n_ports + components[i].guarded.n;
        most = std::max(most, ports);
        ws.active_ports[i].reserve(ports), ws.wires[i].reserve(tensions.terms.size() + nl.all_terms.size());
    }
    ws.free.assign(most, 0.0), ws.compliance.assign(most * most, 0.0);
    ws.all.assign((m + k) * (m + k), 0.0), ws.called.assign(k * m, 0.0), ws.z.assign(k * k, 0.0);
}

// Makes the buffers of a run.
void prepare(const std::vector<Component>& components, const Nonlinear& nl, std::size_t capacity, Workspace& ws) {
    const std::size_t k = nl.k, n = components.size(), n_guarded = nl.n_guarded;
    for (Array<double>* a :
         {&ws.old_p, &ws.free_p, &ws.law_force, &ws.last_force, &ws.series, &ws.series_after, &ws.slip, &ws.slip_after,
          &ws.offset, &ws.offset_after, &ws.velocity, &ws.scale, &ws.size, &ws.clearance, &ws.slack, &ws.rest_p,
          &ws.held, &ws.without, &ws.load})
        a->assign(k, 0.0);
    ws.branch.assign(k, Branch::open);
    ws.awake.assign(k, 0), ws.touching.assign(k, 0), ws.acted.assign(k, 0);
    for (std::vector<int>* list : {&ws.awake_list, &ws.active, &ws.previous, &ws.stored, &ws.sliding})
        list->clear(), list->reserve(k);
    ws.series_alive.assign(nl.n_series, 0);
    ws.pull.assign(n * kBlock, 0.0), ws.pull_worth.assign(n, 0.0);
    ws.norm.assign(n, 0.0), ws.added.assign(n, 0.0), ws.sized.assign(n, 0);
    ws.sizes.assign(nl.groups.empty() ? 0 : capacity, 0.0);
    ws.value.assign(n_guarded * kStride, 0.0), ws.force.assign(n_guarded * kBlock, 0.0);
    ws.row_awake.assign(n_guarded, 0), ws.is_loaded.assign(n_guarded, 0);
    ws.quiet.assign(nl.groups.size(), 0), ws.driven = ws.quiet;
    ws.level.assign(nl.groups.size(), 0.0), ws.level_after.assign(nl.groups.size(), 0.0);
    ws.asleep.assign(nl.groups.size(), 0), ws.least_slack.assign(nl.groups.size(), 0.0);
    ws.awake_rows.resize(n), ws.loaded.resize(n), ws.worth.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const Component& c = components[i];
        ws.awake_rows[i].clear(), ws.awake_rows[i].reserve(c.guarded.n);
        ws.loaded[i].clear(), ws.loaded[i].reserve(c.guarded.n);
        ws.worth[i].assign(nl.group_of[i] < 0 ? 0 : c.n_ports + c.guarded.n, 0.0);
    }
    const std::size_t wide = (k + kLane - 1) / kLane * kLane;
    for (Array<double>& a : ws.x) a.assign(wide, 0.0);
    for (Array<double>* a : {&ws.matrix, &ws.lower, &ws.upper}) a->assign(k * wide, 0.0);
    ws.inverse.assign(std::size_t(kMostLinear) * kMostLinear, 0.0);
    ws.over.assign(wide, 0.0), ws.gathered.clear(), ws.gathered.reserve(k);
}

// Those whose sizes linear connections tell, too. Nothing is known yet of what these answer.
inline void make_room(const Nonlinear& nl, const Layout& layout, Workspace& ws) {
    const std::size_t k = nl.k;
    ws.taken.assign(layout.force_width, 0.0), ws.f0.assign(layout.f_width, 0.0);
    ws.known.assign(k, 0), ws.z.resize(k * k), ws.answer.assign(k * layout.f_width, 0.0);
}

}  // namespace
}  // namespace tonewood
