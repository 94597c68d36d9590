// Block-level broad phase: which contacts can touch in a block. Contacts that a bound excludes are culled: their rows
// are not read, and the samples are the same bit for bit.
//
// At the block's beginning row_bounds.hpp bounds the free motion of each contact port; the gap at rest less that bound is
// the contact's clearance. The port forces of the block use the clearance up: a force F on a port takes sensitivity |F|
// of the tightest clearance in a group of components joined by contacts. While the sum (`share`) is below 1 no culled
// contact touches. In the sample in which it reaches 1, each contact's own bound is evaluated, and contacts that may
// touch become candidates: their rows are read from the block's beginning.
#pragma once

#include "row_bounds.hpp"
#include "contact_rows.hpp"
#include "held.hpp"

namespace tonewood {
namespace {

class BroadPhase {
    using Term = Nonlinear::Term;

public:
    BroadPhase(Block& block, ContactRows& rows)
        : block_(block), rows_(rows), components_(block.model.components), layout_(block.model.layout),
          nl_(block.model.nonlinear), ws_(block.space.contacts), job_(block.job), on_(block.model.shortcuts),
          held_(block) {
        if (!nl_.k) return;
        int n_sums = 0;
        for (const Component& c : components_) {
            any_modulated_ = any_modulated_ || c.modulated;
            sums_at_.push_back(n_sums), n_sums += c.n_ports + c.contact.n + 1;
        }
        sums_.assign(n_sums, 0.0), changed_.assign(nl_.groups.size(), 1);
        for (int j = 0; j < nl_.k; ++j) {
            ws_.highest_offset[j] = -nl_.gap[j];
            // a contact outside of the groups, over a port that does not move, acts only if a control moves it
            ws_.candidate[j] = !nl_.contact[j] || (nl_.group_of_law[j] < 0 && !on_.block_culling);
        }
        for (const Control& control : job_.controls)
            if (nl_.group_of_law[control.connection] < 0) ws_.candidate[control.connection] = 1;
        std::fill(ws_.all_culled.begin(), ws_.all_culled.end(), 0);
        std::fill(ws_.port_sensitivity.begin(), ws_.port_sensitivity.end(), 0.0);
    }

    // Finds the candidates of a block and reads their rows; the row history holds the free motion.
    void begin_block() {
        ++block_.space.statistics.blocks;
        rows_.begin_block();
        sample_ = 0;
        std::fill(ws_.driven.begin(), ws_.driven.end(), 0);
        for (const Control& control : job_.controls) {
            const double* values = control.values + block_.start;
            double highest = values[0];
            for (int b = 0; b < block_.nb; ++b) highest = std::max({highest, values[b], values[job_.n + b]});
            ws_.highest_offset[control.connection] = highest;
            if (nl_.group_of_law[control.connection] >= 0) ws_.driven[nl_.group_of_law[control.connection]] = 1;
        }
        bool same = listed_;
        for (int g = 0; g < int(nl_.groups.size()); ++g) same = bound_group(g) && same;
        if (!same) list_candidates();
        listed_ = true;
        rows_.read_all();
        contact_free_ = on_.direct_step && only_contacts_ && !ws_.any_series && !any_modulated_;
        for (int g = 0; g < int(nl_.groups.size()); ++g) {
            ws_.share[g] = ws_.share_after[g] = 0.0;
            if (!ws_.all_culled[g]) update_sensitivities(g);
            if (same) continue;
            int n_ports = 0;
            for (const int i : nl_.groups[g].components) n_ports += components_[i].n_ports;
            for (const int i : nl_.groups[g].components)
                for (int p = 0; p < components_[i].n_ports; ++p)
                    ws_.port_sensitivity[layout_.port[i] + p] = ws_.sensitivity[i][p] * n_ports;
        }
        if (contact_free_) std::fill(ws_.port_share.begin(), ws_.port_share.end(), 0.0);
    }

    // Whether contact_free may still be true for a sample of this block.
    bool contact_free_so_far() const { return contact_free_; }

    const std::vector<int>& candidates() const { return ws_.candidates; }

    // Whether forces of this block could make a culled contact touch.
    bool any_culled() const {
        return std::any_of(ws_.n_culled.begin(), ws_.n_culled.end(), [](int n) { return n > 0; });
    }

    // Whether no contact can touch in sample b under the port forces `now` of the linear connections.
    bool contact_free(int b, const double* now) {
        if (!contact_free_) return false;
        using S = Simd;
        double* const share = ws_.port_share.data();
        bool below = true;
        for (const int j : ws_.candidates) below = below && stays_open(j, b, now);
        for (int p = 0; p < layout_.force_width; p += S::width) {
            const S::V f = S::load(now + p);
            const S::V sum = S::load(share + p) + S::load(ws_.port_sensitivity.data() + p) * (f < 0.0 ? -f : f);
            S::store(share + p, sum);
        }
        for (int p = 0; p < layout_.force_width; ++p) below = below && share[p] < 1.0;
        if (below) return true;
        contact_free_ = false;
        for (int g = 0; g < int(nl_.groups.size()); ++g)
            for (int s = 0; s < b; ++s) ws_.share[g] += share_of(g, s);
        return false;
    }

    // Adds culled contacts that the forces tried in sample b could bring into touch; `farthest`: largest displacement
    // of the residual compliances in it. `added(j)` is called for each.
    template <class Added>
    void add_candidates(int b, double farthest, const Added& added) {
        sample_ = b;
        for (int index = 0; index < int(nl_.groups.size()); ++index) {
            if (!ws_.n_culled[index]) continue;
            const Nonlinear::Group& group = nl_.groups[index];
            ws_.share_after[index] = ws_.share[index] + share_of(index, b);
            double in_series = 0.0;
            // one bound for all culled contacts first
            if (ws_.any_series && ws_.share_after[index] + farthest / ws_.least_clearance[index] * (1 + kMargin) >= 1.0)
                for (const int j : group.contacts)
                    if (!ws_.candidate[j] && series_in_motion(j)) {
                        const double most = displaced_in_series(j);
                        if (most > in_series * ws_.clearance[j]) in_series = most / ws_.clearance[j];
                    }
            if (ws_.share_after[index] + in_series * (1 + kMargin) < 1.0) continue;
            bool any = false;
            sum_forces(index, b);
            for (const int j : group.contacts) {
                if (ws_.candidate[j] || excursion(j) < ws_.clearance[j]) continue;
                add_candidate(j, b);
                added(j);
                any = true;
            }
            if (!any) continue;
            update_sensitivities(index);
            ws_.share_after[index] = ws_.share[index] + share_of(index, b);
        }
    }

    // The forces of the sample are final.
    void commit() { std::copy(ws_.share_after.begin(), ws_.share_after.end(), ws_.share.begin()); }

    // A force acts on a contact port of component i for the first time in this block, in sample b.
    void port_loaded(int i, int b) {
        sample_ = b;
        if (nl_.group_of[i] >= 0) update_sensitivities(nl_.group_of[i]);
    }

    bool series_in_motion(int j) const { return nl_.series[j] >= 0 && ws_.series_moves[nl_.series[j]]; }
    double displaced_in_series(int j) const {
        return std::max(std::abs(ws_.series[nl_.place[j]]), std::abs(ws_.series_after[nl_.place[j]]));
    }

private:
    void list_candidates() {
        rows_.forget_rows();
        ws_.candidates.clear();
        only_contacts_ = job_.controls.empty();
        for (int j = 0; j < nl_.k; ++j) {
            if (!ws_.candidate[j]) continue;
            ws_.candidates.push_back(j);
            only_contacts_ = only_contacts_ && nl_.only_contact_ports[j];
            for (const Term& t : nl_.terms[j])
                if (t.contact) rows_.mark(t);
        }
    }

    // Clearances of a group's contacts in this block; whether none changed since the block before.
    bool bound_group(int index) {
        const Nonlinear::Group& group = nl_.groups[index];
        double share = 0.0;
        bool held = false;
        for (std::size_t q = 0; q < group.components.size(); ++q) {
            const int i = group.components[q];
            const Component& c = components_[i];
            if (!c.contact.n) continue;
            ws_.added[i] = 0.0, ws_.has_amplitudes[i] = 0;
            if (!block_.inputs[i].empty()) ws_.added[i] = held_.begin_block(i), held = true;
            ws_.norm[i] = norm(c, held_.x(i), held_.y(i));
            if (group.simple) share += (ws_.norm[i] + ws_.added[i]) * group.coarse_sensitivity[q];
        }
        const bool before = ws_.all_culled[index] && !changed_[index];
        changed_[index] = 0;
        ws_.all_culled[index] = on_.block_culling && on_.group_bound && group.simple && !held && !ws_.driven[index] &&
                                share * (1 + kMargin) < kCoarse;
        if (ws_.all_culled[index] && before) return true;
        double& least = ws_.least_clearance[index] = INFINITY;
        for (const int j : group.contacts) {
            double clearance = ws_.all_culled[index] ? (1 - kCoarse) * nl_.gap[j] : -1.0;
            if (!ws_.all_culled[index] && on_.block_culling) {
                clearance = coarse_clearance(j);
                if (!(clearance > 0.0) && on_.fine_bound) clearance = fine_clearance(j);
            }
            ws_.clearance[j] = clearance;
            ws_.candidate[j] = !(clearance > 0.0);
            if (!ws_.candidate[j]) least = std::min(least, clearance);
        }
        if (!ws_.all_culled[index]) return false;
        for (std::size_t q = 0; q < group.components.size(); ++q) {
            const int i = group.components[q];
            std::copy(group.sensitivity[q].begin(), group.sensitivity[q].end(), ws_.sensitivity[i].begin());
            ws_.tension_sensitivity[i] = group.tension_sensitivity[q];
        }
        ws_.n_culled[index] = int(group.contacts.size());
        return false;
    }

    // Clearance left by |row| <= peak norm.
    double coarse_clearance(int j) const {
        double most = 0.0;
        for (const Term& t : nl_.terms[j]) {
            double bound = 0.0;
            if (t.contact)
                bound =
                    components_[t.component].contact.peak[t.port] * (ws_.norm[t.component] + ws_.added[t.component]) +
                    std::abs(held_.row(t.component, t.port));
            else
                for (int b = 0; b <= block_.nb; ++b)
                    bound = std::max(bound, std::abs(rows_.line_of(t)[std::size_t(b) * layout_.width]));
            most += std::abs(t.factor) * bound;
        }
        return -ws_.highest_offset[j] - most * (1 + kMargin);
    }

    // Clearance left by the gap in the middle of the block and its largest change from there.
    double fine_clearance(int j) {
        double low = 0.0, all = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const double size = std::abs(t.factor);
            if (t.contact) {
                const int i = t.component;
                const double peak = components_[i].contact.peak[t.port];
                const Excursion e = excursion_of(components_[i], t.port, held_.x(i), held_.y(i), amplitudes_of(i));
                const double middle = e.middle + held_.row(i, t.port);
                const double far = e.spread + peak * ws_.added[i];
                low += t.factor * middle - size * far;
                all += size * (std::abs(middle) + std::abs(held_.row(i, t.port)) + far + peak * ws_.norm[i]);
            } else {
                double least = t.factor * rows_.line_of(t)[0];
                for (int b = 1; b <= block_.nb; ++b)
                    least = std::min(least, t.factor * rows_.line_of(t)[std::size_t(b) * layout_.width]);
                low += least;
                all += std::abs(least);
            }
        }
        return low - ws_.highest_offset[j] - kMargin * (all + std::abs(ws_.highest_offset[j]));
    }

    // Amplitudes of a component's modes at the beginning of the block, computed once.
    const double* amplitudes_of(int i) {
        double* const out = ws_.amplitudes.data() + components_[i].offset;
        if (!ws_.has_amplitudes[i]) amplitudes(components_[i], held_.x(i), held_.y(i), out);
        ws_.has_amplitudes[i] = 1;
        return out;
    }

    // Whether a candidate on contact ports alone is open before and after sample b if no law acts, beyond rounding.
    bool stays_open(int j, int b, const double* now) const {
        double old = -nl_.gap[j], after = old, error = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const int i = t.component;
            const ContactPorts& g = components_[i].contact;
            const double before = rows_.value(i, t.port)[b];
            double then = rows_.value(i, t.port)[b + 1];
            for (std::size_t p = 0; p < std::size_t(components_[i].n_ports); ++p)
                then += now[layout_.port[i] + p] * g.from_fixed[(p * g.n + t.port) * kBlock];
            old -= t.factor * before, after -= t.factor * then;
            error += kMargin * (std::abs(before) + std::abs(then));
        }
        return old < -error && after < -error;
    }

    // Fractions of the smallest clearance among the culled contacts of a group per newton at each port, and the share
    // that the forces before this sample took. Only ports that are loaded in this block count.
    void update_sensitivities(int index) {
        const Nonlinear::Group& group = nl_.groups[index];
        for (const int i : group.components) {
            std::fill(ws_.sensitivity[i].begin(), ws_.sensitivity[i].end(), 0.0);
            ws_.tension_sensitivity[i] = 0.0;
        }
        ws_.n_culled[index] = 0;
        for (const int j : group.contacts) {
            if (ws_.candidate[j]) continue;
            ++ws_.n_culled[index];
            for (const Term& t : nl_.terms[j]) {
                const double share = std::abs(t.factor) / ws_.clearance[j], *reach = reach_of(t);
                double* sensitivity = ws_.sensitivity[t.component].data();
                each_port(t.component, [&](int p) { sensitivity[p] = std::max(sensitivity[p], share * reach[p]); });
                if (block_.modulated(t.component)) {
                    double& most = ws_.tension_sensitivity[t.component];
                    most = std::max(most, share * components_[t.component].contact.tension_reach[t.port]);
                }
            }
        }
        changed_[index] = 1;
        ws_.share[index] = 0.0;
        for (int b = 0; b < sample_; ++b) ws_.share[index] += share_of(index, b);
    }

    const double* reach_of(const Term& t) const {
        const Component& c = components_[t.component];
        const std::size_t port = t.contact ? c.n_ports + t.port : t.port;
        return c.contact.reach.data() + port * (c.n_ports + c.contact.n);
    }

    // Calls use(port among all of component i) for every port with forces in this block.
    template <class Use>
    void each_port(int i, const Use& use) const {
        const int n_ports = components_[i].n_ports;
        for (int p = 0; p < n_ports; ++p) use(p);
        for (const int p : ws_.loaded[i]) use(n_ports + p);
    }

    // |force| in sample b on a port among all of component i.
    double force_size(int i, int p, int b) const {
        const int n_ports = components_[i].n_ports;
        return std::abs(p < n_ports ? block_.force(b)[layout_.port[i] + p] : rows_.force(i, p - n_ports)[b]);
    }

    // Share of the tightest clearance of a group that the forces of sample b take.
    double share_of(int index, int b) const {
        double sum = 0.0;
        for (const int i : nl_.groups[index].components) {
            each_port(i, [&](int p) { sum += ws_.sensitivity[i][p] * force_size(i, p, b); });
            if (block_.modulated(i))
                sum += ws_.tension_sensitivity[i] * ws_.tension_excursion[std::size_t(i) * kBlock + b];
        }
        return sum;
    }

    // Sums of |force| on the ports of a group up to sample b, and of the tensions' excursions.
    void sum_forces(int index, int b) {
        for (const int i : nl_.groups[index].components) {
            double* const sums = sums_.data() + sums_at_[i];
            each_port(i, [&](int p) {
                double& sum = sums[p] = 0.0;
                for (int s = 0; s <= b; ++s) sum += force_size(i, p, s);
            });
            if (!block_.modulated(i)) continue;
            double& sum = sums[components_[i].n_ports + components_[i].contact.n] = 0.0;
            for (int s = 0; s <= b; ++s) sum += ws_.tension_excursion[std::size_t(i) * kBlock + s];
        }
    }

    // Largest displacement of a culled contact by these.
    double excursion(int j) const {
        double total = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const Component& c = components_[t.component];
            const double *reach = reach_of(t), *sums = sums_.data() + sums_at_[t.component];
            double sum = 0.0;
            each_port(t.component, [&](int p) { sum += reach[p] * sums[p]; });
            if (block_.modulated(t.component)) sum += c.contact.tension_reach[t.port] * sums[c.n_ports + c.contact.n];
            total += std::abs(t.factor) * sum;
        }
        if (series_in_motion(j)) total += displaced_in_series(j);
        return total * (1 + kMargin);
    }

    void add_candidate(int j, int b) {
        ++block_.space.statistics.added;
        ws_.candidate[j] = 1, listed_ = false;
        only_contacts_ = only_contacts_ && nl_.only_contact_ports[j];
        ws_.candidates.insert(std::upper_bound(ws_.candidates.begin(), ws_.candidates.end(), j), j);
        for (const Term& t : nl_.terms[j])
            if (t.contact && !rows_.is_read(t)) rows_.read_late(t, b);
    }

    Block& block_;
    ContactRows& rows_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Nonlinear& nl_;
    ContactState& ws_;
    const Job& job_;
    const Shortcuts& on_;
    HeldStates held_;
    bool any_modulated_ = false;
    bool listed_ = false;         // the list of candidates is that of the block before
    std::vector<char> changed_;   // by group: culled contacts or sensitivities changed in this block
    bool only_contacts_ = false;  // all candidates are contacts on contact ports, none is driven
    bool contact_free_ = false;   // no contact has touched in this block so far
    int sample_ = 0;
    // by component, at `sums_at_`: sums of |force| on its ports, then of its tension's excursions
    std::vector<int> sums_at_;
    Array<double> sums_;
};

}  // namespace
}  // namespace tonewood
