// Nonlinear connections as loaded: groups of contacts with shared bounds, residual compliances, buffers.
#pragma once

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "../data/state.hpp"
#include "bound_tables.hpp"

namespace tonewood {

// Groups of gaps that share residual compliance.
inline void make_series(Nonlinear& nl) {
    const std::size_t k = nl.k;
    nl.series.assign(k, -1), nl.shared.clear();
    std::vector<std::size_t> open;
    for (std::size_t j = 0; j < k; ++j) {
        if (nl.series[j] >= 0 || nl.residual[j * k + j] == 0.0) continue;
        open.push_back(j);
        const int group = nl.series[j] = int(nl.shared.size());
        while (!open.empty()) {
            const std::size_t i = open.back();
            open.pop_back();
            for (std::size_t q = 0; q < k; ++q)
                if (nl.series[q] < 0 && nl.residual[i * k + q] != 0.0) nl.series[q] = group, open.push_back(q);
        }
        nl.shared.emplace_back();
    }
    nl.place.assign(k, 0), nl.n_places = 0;
    for (std::size_t g = 0; g < nl.shared.size(); ++g) {
        Nonlinear::Shared& group = nl.shared[g];
        std::vector<std::size_t> members;
        for (std::size_t j = 0; j < k; ++j)
            if (nl.series[j] == int(g)) members.push_back(j);
        group.first = nl.n_places, group.n = int(members.size()), group.width = int(padded(members.size()));
        group.residual.assign(members.size() * group.width, 0.0);
        for (std::size_t i = 0; i < members.size(); ++i)
            for (std::size_t j = 0; j < members.size(); ++j)
                group.residual[i * group.width + j] = nl.residual[members[i] * k + members[j]];
        for (std::size_t i = 0; i < members.size(); ++i) nl.place[members[i]] = group.first + int(i);
        nl.n_places += group.width;
    }
    for (std::size_t j = 0; j < k; ++j)
        if (nl.series[j] < 0) nl.place[j] = nl.n_places;
}

// Sorts the terms by connection and joins the components of contacts on contact ports to groups, in which any force may
// use any clearance up.
inline void make_groups(std::vector<Component>& components, Nonlinear& nl) {
    const int n = int(components.size());
    nl.terms.assign(nl.k, {}), nl.driven.assign(nl.k, {}), nl.contact.assign(nl.k, 0);
    nl.groups.clear(), nl.group_of.assign(n, -1), nl.first.clear();
    nl.group_of_law.assign(nl.k, -1), nl.only_contact_ports.assign(nl.k, 0), nl.gap.assign(nl.k, 0.0);
    nl.n_contact = 0;
    for (const Component& c : components) nl.first.push_back(nl.n_contact), nl.n_contact += c.contact.n;
    for (const Nonlinear::Term& t : nl.all_terms) {
        const Component& c = components[t.component];
        if (t.port >= (t.contact ? c.contact.n : c.n_ports) ||
            (t.contact && !nl.laws[t.connection].one_sided()))
            throw std::invalid_argument("kernel: nonlinear.terms: connection " + std::to_string(t.connection) +
                                        " has no such port, or is no contact");
        (c.driven ? nl.driven : nl.terms)[t.connection].push_back(t);
        nl.contact[t.connection] |= t.contact;
    }
    for (int j = 0; j < nl.k; ++j) {
        nl.gap[j] = -nl.laws[j].offset;
        nl.only_contact_ports[j] = nl.laws[j].one_sided();
        for (const Nonlinear::Term& t : nl.terms[j]) nl.only_contact_ports[j] &= t.contact;
    }
    // no bound is known of the fixed ports of strings that are stepped sample by sample
    for (const Nonlinear::Term& t : nl.all_terms)
        if (!t.contact && (components[t.component].by_sample()))
            nl.contact[t.connection] = 0;
    // a contact under which nothing moves, behind the stop of a string, is in no group
    const auto is_idle = [&](int j) {
        for (const Nonlinear::Term& t : nl.terms[j])
            if (!t.contact || components[t.component].contact.peak[t.port] > 0.0) return false;
        return nl.laws[j].offset <= 0.0 && nl.series[j] < 0;
    };
    for (int j = 0; j < nl.k; ++j) {
        if (!nl.contact[j] || is_idle(j)) continue;
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
            if (components[i].contact.reach.empty()) components[i].contact.reach = reach_of(components[i]);
        }
        Nonlinear::Group& group = nl.groups[g];
        const std::size_t n_parts = group.components.size();
        group.simple = true;
        group.coarse_sensitivity.assign(n_parts, 0.0), group.tension_sensitivity = group.coarse_sensitivity;
        group.sensitivity.assign(n_parts, {});
        for (std::size_t q = 0; q < n_parts; ++q)
            group.sensitivity[q].assign(components[group.components[q]].n_ports, 0.0);
        for (const int j : group.contacts) {
            const double room = -nl.laws[j].offset;
            nl.group_of_law[j] = int(g);
            group.simple = group.simple && room > 0.0;
            for (const Nonlinear::Term& t : nl.terms[j]) {
                group.simple = group.simple && t.contact;
                if (!group.simple) break;
                const auto& parts = group.components;
                const std::size_t q = std::find(parts.begin(), parts.end(), t.component) - parts.begin();
                const Component& c = components[t.component];
                const double size = std::abs(t.factor), of_clearance = size / ((1 - kCoarse) * room);
                group.coarse_sensitivity[q] =
                    std::max(group.coarse_sensitivity[q], size * c.contact.peak[t.port] / room);
                const double* reach =
                    c.contact.reach.data() + (std::size_t(c.n_ports + t.port) * (c.n_ports + c.contact.n));
                for (int p = 0; p < c.n_ports; ++p)
                    group.sensitivity[q][p] = std::max(group.sensitivity[q][p], of_clearance * reach[p]);
                if (c.modulated)
                    group.tension_sensitivity[q] =
                        std::max(group.tension_sensitivity[q], of_clearance * c.contact.tension_reach[t.port]);
            }
        }
    }
}

// Makes the buffers of a run with nonlinear connections.
inline void make_buffers(const std::vector<Component>& components, const Nonlinear& nl, std::size_t capacity,
                         ContactState& ws) {
    const std::size_t k = nl.k, n = components.size(), n_contact = nl.n_contact;
    for (Array<double>* a :
         {&ws.old_p, &ws.free_p, &ws.law_force, &ws.last_force, &ws.slip, &ws.slip_after,
          &ws.offset, &ws.offset_after, &ws.velocity, &ws.scale, &ws.size, &ws.highest_offset, &ws.clearance,
          &ws.held, &ws.without, &ws.load})
        a->assign(k, 0.0);
    ws.branch.assign(k, Branch::open);
    ws.candidate.assign(k, 0), ws.is_active.assign(k, 0), ws.acted.assign(k, 0);
    for (std::vector<int>* list : {&ws.candidates, &ws.active, &ws.previous, &ws.stored, &ws.sliding})
        list->clear(), list->reserve(k);
    ws.series.assign(nl.n_places + kLane, 0.0), ws.series_after = ws.series;
    ws.series_moves.assign(nl.shared.size(), 0);
    ws.tension_excursion.assign(n * kBlock, 0.0), ws.tension_sensitivity.assign(n, 0.0);
    ws.norm.assign(n, 0.0), ws.added.assign(n, 0.0), ws.has_amplitudes.assign(n, 0);
    ws.amplitudes.assign(nl.groups.empty() ? 0 : capacity, 0.0);
    ws.value.assign(n_contact * kStride, 0.0), ws.force.assign(n_contact * kBlock, 0.0);
    ws.row_is_read.assign(n_contact, 0), ws.is_loaded.assign(n_contact, 0);
    ws.all_culled.assign(nl.groups.size(), 0), ws.driven = ws.all_culled;
    ws.share.assign(nl.groups.size(), 0.0), ws.share_after.assign(nl.groups.size(), 0.0);
    ws.n_culled.assign(nl.groups.size(), 0), ws.least_clearance.assign(nl.groups.size(), 0.0);
    ws.rows_read.resize(n), ws.loaded.resize(n), ws.sensitivity.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const Component& c = components[i];
        ws.rows_read[i].clear(), ws.rows_read[i].reserve(c.contact.n);
        ws.loaded[i].clear(), ws.loaded[i].reserve(c.contact.n);
        ws.sensitivity[i].assign(nl.group_of[i] < 0 ? 0 : c.n_ports + c.contact.n, 0.0);
    }
    const std::size_t wide = padded(k);
    for (Array<double>& a : ws.x) a.assign(wide, 0.0);
    for (Array<double>* a : {&ws.matrix, &ws.lower, &ws.upper}) a->assign(k * wide, 0.0);
    ws.over.assign(wide, 0.0), ws.gathered.clear(), ws.gathered.reserve(k);
}

// Makes the buffers whose size depends on the linear connections too; no response of these is known yet.
inline void reset_responses(const Nonlinear& nl, const Layout& layout, ContactState& ws) {
    const std::size_t k = nl.k;
    ws.port_share.assign(layout.force_width, 0.0), ws.port_sensitivity = ws.port_share;
    ws.f0.assign(layout.f_width, 0.0);
    ws.has_response.assign(k, 0), ws.z.resize(k * k), ws.answer.assign(k * layout.f_width, 0.0);
}

}  // namespace tonewood
