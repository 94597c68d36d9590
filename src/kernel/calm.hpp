// Contacts that nothing can reach for kWeave blocks: a bound by energy, so that their strings may stay woven.
//
// A mode that a port reads as u, with its static compliance c and its frequency w, carries
//
//     V = (u^2 + (u'/w)^2) / 2c,      V(t + h) <= V(t) + F (u(t + h) - u(t)),
//
// under a force F held over a step: the work of the force is exact, since the propagator is, and what damping takes
// away is left in. So the energy V of a string of one port is bounded sample by sample from what is known anyhow.
// Another place of it reads each mode as a u + b u'/w, hence by Cauchy-Schwarz, for any number L,
//
//     |row| <= L |u| + sqrt(2 D V),   D = sum c ((a - L)^2 + b^2).
//
// With L as the string leans when its port is moved slowly, D is the compliance at that place while the port is fast.
// A group of contacts is calm for a window if the energies of its strings leave it room; the step in which one
// passes what it was given is looked at again the other way (nonlinear.hpp).
//
// Strings of one rising tension have its potential besides, kappa S^2 / 2, and each may take all that they have
// together: that sum is bounded, for what the tension does to modes is force held over a step, and the discrete gradient
// takes as much from the potential. Nothing is known of their ports before their step is found (tense_contacts.hpp).
//
// Strings on which known forces act are not woven. Block by block the same is said of their motion about the place
// where the means of these forces would hold them, the port where it is; a deviation e from the mean adds e z to the
// state in its step, so that sqrt V grows by |e| sqrt V(z), and V, while below v, by 2 |e| sqrt(v V(z)) + e^2 V(z).
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "simd.hpp"

namespace tonewood {
namespace {

// Room for rounding, and for how exactly modes and tensions are known, relative.
constexpr double kEnergyMargin = 1e-6;

double energy(const Component& c, const double* x, const double* y) {
    using S = Simd;
    const double *of_x = c.guarded.energy.data(), *of_y = of_x + c.n;
    S::V sum{}, more{};
    for (int k = 0; k < c.n; k += S::width) {
        const auto a = S::load(x + k), b = S::load(y + k);
        sum += S::load(of_x + k) * a * a;
        more += S::load(of_y + k) * b * b;
    }
    return S::sum(sum + more);
}

// S of a string's polarization.
double stretched(const Component& c, const double* x) {
    using S = Simd;
    S::V sum{};
    for (int k = 0; k < c.n; k += S::width) {
        const auto y = S::load(c.stretched.reading.data() + k) * S::load(x + k);
        sum += S::load(c.stretched.a.data() + k) * y * y;
    }
    return S::sum(sum);
}

double read(const Component& c, const double* row, const double* modes) {
    using S = Simd;
    S::V sum{};
    for (int k = 0; k < 2 * c.n; k += S::width) sum += S::load(row + k) * S::load(modes + k);
    return S::sum(sum);
}

// What an input does that stays as it is, per its value.
struct Held {
    const double* vector;
    Array<double> modes;  // (2, n): the state that it holds
    Array<double> rows;  // (n_guarded) in that state
    double port, jump;   // the port in that state; by how far one step moves it
    double size;         // square root of the energy that one step gives
    bool whole = true;   // no mode drifts under it
};

Held hold(const Component& c, const double* vector) {
    const std::size_t n = c.n;
    const double size = c.guarded.energy.empty() ? 0.0 : std::sqrt(energy(c, vector, vector + n));
    Held held{vector, Array<double>(2 * n), Array<double>(c.guarded.n), 0.0, 0.0, size};
    using S = Simd;
    for (std::size_t k = 0; k < n; k += S::width) {
        const auto x = S::load(vector + k), y = S::load(vector + n + k), kappa = S::load(c.kappa.data() + k);
        const auto per = kappa > 0.0 ? 1.0 / kappa : S::V{};
        const auto e00 = S::load(c.e.data() + k), e01 = S::load(c.e.data() + n + k);
        const auto e10 = S::load(c.e.data() + 2 * n + k), e11 = S::load(c.e.data() + 3 * n + k);
        S::store(held.modes.data() + k, per * ((1.0 - e11) * x + e01 * y));
        S::store(held.modes.data() + n + k, per * (e10 * x + (1.0 - e00) * y));
    }
    for (std::size_t k = 0; k < n; ++k)
        held.whole = held.whole && (c.kappa[k] > 0.0 || (vector[k] == 0.0 && vector[n + k] == 0.0));
    for (std::size_t r = 0; r < held.rows.size(); ++r)
        held.rows[r] = read(c, c.guarded.rows.data() + 2 * r * n, held.modes.data());
    if (c.n_ports > 0)
        held.port = read(c, c.rows.data(), held.modes.data()), held.jump = read(c, c.rows.data(), vector);
    return held;
}

class Calm {
    using S = Simd;
    enum : char { no, for_window, for_block };

public:
    Calm(const std::vector<Component>& components, const Layout& layout, const Nonlinear& nl, const Tensions& tensions)
        : components_(components), layout_(layout), nl_(nl), calm_(nl.groups.size(), no), tense_(nl.groups.size(), 0) {
        if (!nl_.k) return;
        const std::size_t n = layout_.single_width;
        energy_.assign(n, 0.0), after_ = shift_ = held_force_ = own_ = energy_;
        most_.assign(n, std::numeric_limits<double>::infinity()), sway_ = most_;
        worth_.assign(layout_.force_width, 0.0);
        part_.assign(components_.size(), 0);
        for (const Nonlinear::Group& group : nl_.groups)
            for (std::size_t q = 0; q < group.components.size(); ++q) part_[group.components[q]] = int(q);
        pool_of_.assign(components_.size(), -1);
        for (const auto& string : tensions.strings) {
            const int group = nl_.group_of[string.components.front()];
            bool together = group >= 0 && nl_.groups[group].calm;
            for (const int i : string.components) together = together && nl_.group_of[i] == group;
            for (const int i : string.components) {
                if (nl_.group_of[i] >= 0) tense_[nl_.group_of[i]] |= together ? kTense : kTense | kBarred;
                if (together) pool_of_[i] = int(pools_.size());
            }
            if (together) pools_.push_back({string.components, string.kappa});
        }
    }

    bool any() const { return count_ > 0; }
    bool all() const { return count_ == int(calm_.size()); }
    bool all_for_window() const { return all() && !n_pushed_; }
    bool operator[](int group) const { return calm_[group] != no; }
    // whether tensions rise in a group
    bool tense(int group) const { return tense_[group] != 0; }
    // what a newton at a port takes of the tightest slack where contacts are bounded block by block, as Nonlinear::worth
    double* worth() { return worth_.data(); }

    // A window begins in the state of `job`. Group g may be calm if `may(g)`.
    template <class May>
    void begin(const Job& job, const May& may) {
        for (int g = 0; g < int(calm_.size()); ++g) {
            release(g);
            if (!nl_.groups[g].calm || tense_[g] & kBarred || !may(g)) continue;
            const Nonlinear::Group& group = nl_.groups[g];
            for (const int i : group.components) {
                const std::size_t offset = components_[i].offset;
                energy_[layout_.port[i]] = energy(components_[i], job.modes[0] + offset, job.modes[1] + offset);
            }
            for (const Pool& pool : pools_) {
                if (nl_.group_of[pool.components[0]] != g) continue;
                double stretch = 0.0;
                for (const int i : pool.components) stretch += stretched(components_[i], job.modes[0] + components_[i].offset);
                energy_[layout_.port[pool.components[0]]] += 0.5 * pool.kappa * stretch * stretch;
                gather(pool, energy_);
            }
            take(g, group.strain, group.sway, nullptr, for_window);
        }
    }

    // A block of nb samples begins, with known inputs on components of group g: whether it is calm in it.
    bool begin_block(int g, const Job& job, const std::vector<std::vector<Input>>& known, int nb) {
        release(g);
        const Nonlinear::Group& group = nl_.groups[g];
        const std::size_t n_parts = group.components.size(), width = layout_.single_width;
        if (jumps_.empty()) jumps_.assign(kBlock * width, 0.0), at_rest_.assign(nl_.n_guarded, 0.0);
        for (Array<double>* a : {&added_, &strain_, &sway_of_}) a->assign(n_parts, 0.0);
        for (std::size_t q = 0; q < n_parts; ++q) {
            const int i = group.components[q], lane = layout_.port[i];
            const Component& c = components_[i];
            const double *x = job.modes[0] + c.offset, *y = job.modes[1] + c.offset;
            double* const rows = at_rest_.data() + (nl_.first[i]);
            std::fill_n(rows, c.guarded.n, 0.0);
            shift_[lane] = held_force_[lane] = 0.0;
            double jumps[kBlock] = {}, added = 0.0, port = 0.0;
            if (!known[i].empty()) {
                moved_.resize(2 * c.n);
                std::copy_n(x, c.n, moved_.data()), std::copy_n(y, c.n, moved_.data() + c.n);
                for (const Input& input : known[i]) {
                    double values[kBlock] = {}, mean = 0.0, off = 0.0;
                    for (int b = 0; b < nb; ++b) mean += values[b] = input.values[b * input.stride];
                    mean /= nb;
                    const Held& held = held_by(c, input.vector);
                    for (int b = 0; b < nb; ++b) {
                        values[b] -= mean;
                        off += std::abs(values[b]), jumps[b] += values[b] * held.jump;
                    }
                    added += off * held.size;
                    settle(mean, held, rows, port);
                }
                // and a force on the port that keeps it where it is
                const Held& kept = held_by(c, c.w.data());
                held_force_[lane] = read(c, c.rows.data(), moved_.data()) / kept.port;
                settle(held_force_[lane], kept, rows, port);
                energy_[lane] = energy(c, moved_.data(), moved_.data() + c.n);
            } else {
                energy_[lane] = energy(c, x, y);
            }
            for (int b = 0; b < kBlock; ++b) jumps_[b * width + lane] = jumps[b];
            added_[q] = added, shift_[lane] = port;
        }
        for (const int j : group.contacts) {
            double room = -nl_.laws[j].offset * (1 - kEnergyMargin);
            for (const Nonlinear::Term& t : nl_.terms[j]) room += t.factor * at_rest_[nl_.first[t.component] + t.port];
            if (!(room > 0.0)) return release(g), false;
            const double over = 1.0 / room;
            for (const Nonlinear::Term& t : nl_.terms[j]) {
                const int q = part_[t.component];
                const Guarded& guarded = components_[t.component].guarded;
                const double per = std::abs(t.factor) * over, lean = per * guarded.lean[t.port];
                strain_[q] = std::max(strain_[q], per * guarded.swing[t.port]);
                sway_of_[q] = std::max(sway_of_[q], lean);
            }
        }
        for (std::size_t q = 0; q < n_parts; ++q)
            strain_[q] /= 1 - kSway, sway_of_[q] = kSway / (sway_of_[q] * double(n_parts));
        return take(g, strain_, sway_of_, added_.data(), for_block);
    }

    // The state of component i at a block's beginning, counted from where the means of its known inputs would hold it:
    // in `moved`, its guarded rows there in `held_at`. Returns the most that deviations from the means add to its size.
    template <class Size>
    double settle_about(int i, const Job& job, const std::vector<Input>& known, int nb, const Size& size) {
        const Component& c = components_[i];
        const std::size_t n = c.n;
        if (at_rest_.empty()) at_rest_.assign(nl_.n_guarded, 0.0);
        if (states_.empty()) states_.resize(components_.size());
        Array<double>& state = states_[i];
        state.assign(job.modes[0] + c.offset, job.modes[0] + c.offset + n);
        state.insert(state.end(), job.modes[1] + c.offset, job.modes[1] + c.offset + n);
        double* const rows = at_rest_.data() + (nl_.first[i]);
        std::fill_n(rows, c.guarded.n, 0.0);
        double added = 0.0;
        for (const Input& input : known) {
            double mean = 0.0, off = 0.0;
            for (int b = 0; b < nb; ++b) mean += input.values[b * input.stride];
            mean /= nb;
            for (int b = 0; b < nb; ++b) off += std::abs(input.values[b * input.stride] - mean);
            const Held& held = held_by(c, input.vector);
            if (!held.whole) {
                for (int b = 0; b < nb; ++b) added += std::abs(input.values[b * input.stride]) * size(input.vector);
                continue;
            }
            for (std::size_t k = 0; k < 2 * n; ++k) state[k] -= held.modes[k] * mean;
            for (std::size_t r = 0; r < held.rows.size(); ++r) rows[r] += mean * held.rows[r];
            added += off * size(input.vector);
        }
        return added;
    }
    const double* moved(int i) const { return states_[i].data(); }
    double held_at(int guarded) const { return at_rest_[guarded]; }

    // No group is calm.
    void end() {
        for (int g = 0; count_ && g < int(calm_.size()); ++g) release(g);
    }
    void end_block() {
        for (int g = 0; n_pushed_ && g < int(calm_.size()); ++g)
            if (calm_[g] == for_block) release(g);
    }

    void release(int g) {
        const Nonlinear::Group& group = nl_.groups[g];
        if (!group.calm) return;
        for (const int i : group.components) {
            const int lane = layout_.port[i];
            energy_[lane] = shift_[lane] = held_force_[lane] = 0.0;
            most_[lane] = sway_[lane] = std::numeric_limits<double>::infinity();
            if (pool_of_[i] >= 0) pools_[pool_of_[i]].most = most_[lane];
        }
        count_ -= calm_[g] != no, n_pushed_ -= calm_[g] == for_block, calm_[g] = no;
    }

    // What the port of a string whose tension rises comes to but for its compliance at rest, as found for this sample.
    void comes_to(int lane, double u) { own_[lane] = u; }

    // Energies after sample b of the block under port forces `now`, between the line at its beginning and the free one
    // after it; false if one passes what it was given.
    bool meets(int b, const double* line, const double* now) {
        return n_pushed_ ? meets<true>(b, line, now) : meets<false>(b, line, now);
    }

    // A block of a window in which all groups are calm, after the fact: energies of all its samples, which stand unless
    // one passes what it was given.
    bool stays(const double* lines, const double* force) {
        S::V least{};
        for (int p = 0; p < layout_.single_width; p += S::width) {
            const S::V most = S::load(most_.data() + p), sway = S::load(sway_.data() + p);
            S::V sum = S::load(energy_.data() + p), u = S::load(lines + p), highest = sum, farthest{};
            for (int b = 0; b < kBlock; ++b) {
                const S::V next = S::load(lines + std::size_t(b + 1) * layout_.width + p);
                const S::V size = next < 0.0 ? -next : next;
                sum += S::load(force + std::size_t(b) * layout_.force_width + p) * (next - u);
                highest = highest < sum ? sum : highest, farthest = farthest < size ? size : farthest;
                u = next;
            }
            S::store(after_.data() + p, sum);
            const S::V left = most - highest, room = sway - farthest;
            least = left < least ? left : least;
            least = room < least ? room : least;
        }
        if (S::sum(least) < 0.0) return false;
        commit();
        return true;
    }

    // Of a group, as `meets` found.
    bool passed(int g, const double* line, const double* now) const {
        for (const int i : nl_.groups[g].components) {
            const int p = layout_.port[i];
            const double u = line[layout_.width + p] + own_[p] + layout_.single_history[p] * now[p] - shift_[p];
            const double most = pool_of_[i] < 0 || !leads(i) ? most_[p] : pools_[pool_of_[i]].most;
            if (!(after_[p] <= most) || !(std::abs(u) <= sway_[p])) return true;
        }
        return false;
    }

    // The step stands.
    void commit() { std::swap(energy_, after_); }

private:
    static constexpr char kTense = 1, kBarred = 2;

    // Components of one rising tension; the energy of all is kept at the port of the first.
    struct Pool {
        std::vector<int> components;
        double kappa, most = std::numeric_limits<double>::infinity();
    };
    bool leads(int i) const { return pools_[pool_of_[i]].components[0] == i; }
    double& gather(const Pool& pool, Array<double>& energy) const {
        double& all = energy[layout_.port[pool.components[0]]];
        for (std::size_t q = 1; q < pool.components.size(); ++q) {
            double& one = energy[layout_.port[pool.components[q]]];
            all += one, one = 0.0;
        }
        return all;
    }

    // The state in `moved_` is counted from where an input of this size holds it.
    void settle(double size, const Held& held, double* rows, double& port) {
        using V = Simd;
        for (std::size_t k = 0; k < held.modes.size(); k += V::width)
            V::store(moved_.data() + k, V::load(moved_.data() + k) - V::load(held.modes.data() + k) * size);
        for (std::size_t r = 0; r < held.rows.size(); ++r) rows[r] += size * held.rows[r];
        port += size * held.port;
    }

    template <bool pushed>
    bool meets(int b, const double* line, const double* now) {
        S::V least{};
        for (int p = 0; p < layout_.single_width; p += S::width) {
            S::V force = S::load(now + p);
            S::V u = S::load(line + layout_.width + p) + S::load(own_.data() + p) + S::load(layout_.single_history.data() + p) * force;
            S::V way = u - S::load(line + p);
            if constexpr (pushed) {
                way -= S::load(jumps_.data() + (std::size_t(b) * layout_.single_width + p));
                u -= S::load(shift_.data() + p);
                force -= S::load(held_force_.data() + p);
            }
            const S::V next = S::load(energy_.data() + p) + force * way;
            S::store(after_.data() + p, next);
            const S::V size = u < 0.0 ? -u : u;
            const S::V left = S::load(most_.data() + p) - next, room = S::load(sway_.data() + p) - size;
            least = left < least ? left : least;
            least = room < least ? room : least;
        }
        bool below = !(S::sum(least) < 0.0);
        for (const Pool& pool : pools_) below = gather(pool, after_) <= pool.most && below;
        return below;
    }

    // Shares the room out among the strings of a group, whose energies stand in their lanes; `added`: the most that
    // square roots of these are still given.
    bool take(int g, const Array<double>& strain, const Array<double>& sway, const double* added, char how) {
        const Nonlinear::Group& group = nl_.groups[g];
        const std::size_t n = group.components.size();
        const auto root = [&](std::size_t q) {
            return std::sqrt(std::max(energy_[layout_.port[group.components[q]]], 0.0)) + (added ? added[q] : 0.0);
        };
        // that of a pool, as Cauchy has it, at its first string
        const auto strain_at = [&](std::size_t q) {
            const int i = group.components[q], pool = pool_of_[i];
            if (pool < 0) return strain[q];
            double sum = 0.0;
            for (const int other : pools_[pool].components)
                if (leads(i)) sum += strain[part_[other]] * strain[part_[other]];
            return std::sqrt(sum);
        };
        double spare = 1.0 - kEnergyMargin;
        for (std::size_t q = 0; q < n; ++q) spare -= root(q) * strain_at(q);
        if (!(spare > 0.0)) return release(g), false;
        for (std::size_t q = 0; q < n; ++q) {
            const int i = group.components[q], lane = layout_.port[i];
            sway_[lane] = sway[q], worth_[lane] = 0.0;
            const double each = strain_at(q);
            if (each == 0.0) continue;
            const double most = root(q) + spare / (double(n) * each);
            (pool_of_[i] < 0 ? most_[lane] : pools_[pool_of_[i]].most) = most * most;
            if (!added) continue;
            energy_[lane] += (2 * most + added[q]) * added[q];
            if (!(energy_[lane] < most_[lane])) return release(g), false;
        }
        calm_[g] = how, ++count_, n_pushed_ += how == for_block;
        return true;
    }

    const Held& held_by(const Component& c, const double* vector) {
        for (const Held& held : held_)
            if (held.vector == vector) return held;
        return held_.emplace_back(hold(c, vector));
    }

    const std::vector<Component>& components_;
    const Layout& layout_;
    const Nonlinear& nl_;
    std::vector<char> calm_;
    std::vector<char> tense_;
    std::vector<int> part_;     // by component: its place in its group
    std::vector<int> pool_of_;  // likewise
    std::vector<Pool> pools_;
    int count_ = 0, n_pushed_ = 0;
    Array<double> energy_, after_, most_, sway_, own_;  // (single_width): by port
    // where inputs hold it, with which force on it (single_width), and how far they move it (kBlock, single_width)
    Array<double> shift_, held_force_, jumps_;
    Array<double> worth_;                         // (force_width)
    std::vector<Held> held_;                      // of this run
    Array<double> at_rest_, added_, strain_, sway_of_;
    Array<double> moved_;
    std::vector<Array<double>> states_;
};

}  // namespace
}  // namespace tonewood
