// Nonlinear connections within a block: which contacts may be left out, and the forces of each sample.
//
// Rows and forces of guarded ports live here, apart from the lines of the other rows; the response of each to the
// other is added sample by sample, in one order, so that a row has the same value whether it was read from the
// beginning of the block or only when its contact woke.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>

#include "calm.hpp"
#include "guard.hpp"
#include "law_solve.hpp"
#include "lines.hpp"
#include "taut.hpp"

namespace tonewood {
namespace {

class TenseContacts;

constexpr double kStillSeries = 1e-30;  // m: residual compliance below this is at rest

class NonlinearStep {
    using Term = Nonlinear::Term;
    friend class TenseContacts;

public:
    NonlinearStep(const std::vector<Component>& components, const Layout& layout, const Solve& solve,
                  const Nonlinear& nonlinear, const Tensions& tensions, Workspace& workspace, Statistics& statistics,
                  const Job& job, const std::vector<std::vector<Input>>& known, Taut& taut)
        : components_(components), layout_(layout), solve_(solve), m_(solve.m), nl_(nonlinear), ws_(workspace),
          statistics_(statistics), job_(job), known_(known), taut_(taut),
          calm_(components, layout, nonlinear, tensions) {
        for (const Component& c : components_) any_tense_ = any_tense_ || c.stretched.on;
        if (!nl_.k) return;
        int n_pressed = 0;
        for (const Component& c : components_)
            pressed_at_.push_back(n_pressed), n_pressed += c.n_ports + c.guarded.n + 1;
        pressed_.assign(n_pressed, 0.0);
        std::copy_n(job.series, nl_.k, ws_.series.data());
        std::copy_n(job.slip, nl_.k, ws_.slip.data());
        std::copy_n(job.last_force, nl_.k, ws_.last_force.data());
        std::fill(ws_.touching.begin(), ws_.touching.end(), 0), std::fill(ws_.acted.begin(), ws_.acted.end(), 0);
        std::fill(ws_.series_alive.begin(), ws_.series_alive.end(), 0);
        ws_.any_alive = false;
        ws_.gathered.clear();
        ws_.previous.clear();
        for (int j = 0; j < nl_.k; ++j) {
            const Law& law = nl_.laws[j];
            ws_.offset[j] = ws_.offset_after[j] = ws_.clearance[j] = law.offset;
            ws_.velocity[j] = law.velocity, ws_.scale[j] = 1.0;
            // one that nothing moves under, and that is in no group for it, can act only if it is moved itself
            ws_.awake[j] = !nl_.guarded[j] || (nl_.group_of_law[j] < 0 && !nl_.asleep_allowed);
            if (ws_.last_force[j] != 0.0) ws_.previous.push_back(j);
            if (nl_.series[j] >= 0 && ws_.series[j] != 0.0) ws_.series_alive[nl_.series[j]] = ws_.any_alive = true;
        }
        for (int q = 0; q < job_.n_controls; ++q)
            if (nl_.group_of_law[job_.controls[q].connection] < 0) ws_.awake[job_.controls[q].connection] = 1;
    }

    // Writes back what moved.
    void finish() {
        if (!nl_.k) return;
        std::copy_n(ws_.series.data(), nl_.k, job_.series);
        std::copy_n(ws_.slip.data(), nl_.k, job_.slip);
        std::copy_n(ws_.last_force.data(), nl_.k, job_.last_force);
    }

    // A window of kWeave blocks begins: which groups of contacts are out of reach in it. `whole`: all of its blocks
    // will come; `bounded`: energies may bound strings (calm.hpp). `may(i)` whether those of component i may, which known
    // forces forbid; `follow(i)` brings its modes to the beginning of the present block, and `leave(i)` does
    // besides what it takes that it is woven no more.
    template <class May>
    void begin_window(bool whole, bool bounded, const May& may) {
        if (!nl_.k) return;
        bounded_ = bounded;
        if (!whole || !bounded) return calm_.end();
        calm_.begin(job_, [&](int g) {
            ++statistics_.windows;
            for (const int i : nl_.groups[g].components)
                if (!may(i)) return false;
            for (int q = 0; q < job_.n_controls; ++q)
                if (nl_.group_of_law[job_.controls[q].connection] == g) return false;
            return !moved_by_series(g);
        });
        for (int g = 0; g < int(nl_.groups.size()); ++g) statistics_.calm += calm_[g];
    }

    // Whether nothing can reach the contacts of a component in this window.
    bool calm(int i) const { return nl_.k && nl_.group_of[i] >= 0 && calm_[nl_.group_of[i]]; }

    // Whether the next block asks for the state of a component, in the same window.
    bool asks(int i) const { return nl_.k && nl_.group_of[i] >= 0 && !calm_[nl_.group_of[i]]; }

    std::function<void(int)> follow, leave;  // see begin_window

    // A block of nb samples from `start` begins, the lines hold its free motion: which contacts sleep in it, and how
    // far the forces may move them before they are looked at.
    // `force` (kBlock, force_width) will hold the forces on fixed ports.
    void begin_block(std::int64_t start, int nb, double* lines, const double* force) {
        start_ = start, nb_ = nb, lines_ = lines, fixed_forces_ = force;
        ++statistics_.blocks;
        if (rested_ && calm_.all_for_window()) return;  // nothing of the below has changed since
        calm_.end_block();
        for (int i = 0; i < int(components_.size()); ++i) ws_.awake_rows[i].clear(), ws_.loaded[i].clear();
        std::fill(ws_.row_awake.begin(), ws_.row_awake.end(), 0);
        std::fill(ws_.is_loaded.begin(), ws_.is_loaded.end(), 0);
        sample_ = 0, reads_ = loads_ = false, plain_ = !job_.n_controls;
        std::fill(ws_.driven.begin(), ws_.driven.end(), 0);
        for (int q = 0; q < job_.n_controls; ++q) {
            const Control& control = job_.controls[q];
            const double* values = control.values + start_;
            double highest = values[0];
            for (int b = 0; b < nb_; ++b) highest = std::max({highest, values[b], values[job_.n + b]});
            ws_.clearance[control.connection] = highest;
            if (nl_.group_of_law[control.connection] >= 0) ws_.driven[nl_.group_of_law[control.connection]] = 1;
        }
        for (int g = 0; g < int(nl_.groups.size()); ++g) {
            if (calm_[g] || calm_for_block(g))
                rest(g);
            else
                guard(g);
            double& least = ws_.least_slack[g] = INFINITY;
            for (const int j : nl_.groups[g].contacts)
                if (!ws_.awake[j]) least = std::min(least, ws_.slack[j]);
        }
        ws_.awake_list.clear();
        for (int j = 0; j < nl_.k; ++j) {
            if (!ws_.awake[j]) continue;
            ws_.awake_list.push_back(j);
            plain_ = plain_ && is_plain(j);
            for (const Term& t : nl_.terms[j])
                if (t.guarded) mark_row(t);
        }
        for (int i = 0; i < int(components_.size()); ++i)
            if (!ws_.awake_rows[i].empty() && !tense(i)) read(i, ws_.awake_rows[i].data(), int(ws_.awake_rows[i].size()));
        still_ = (ws_.awake_list.empty() || plain_) && !ws_.any_alive;
        if (any_tense_) still_ = still_ && ws_.awake_list.empty() && calm_.all();
        for (int g = 0; g < int(nl_.groups.size()); ++g) {
            if (calm_[g]) continue;
            if (!ws_.quiet[g]) weigh(g);
            int n_ports = 0;
            for (const int i : nl_.groups[g].components) n_ports += components_[i].n_ports;
            for (const int i : nl_.groups[g].components)
                for (int p = 0; p < components_[i].n_ports; ++p)
                    calm_.worth()[layout_.port[i] + p] = ws_.worth[i][p] * n_ports;
        }
        if (still_) std::fill(ws_.taken.begin(), ws_.taken.end(), 0.0);
        rested_ = still_ && calm_.all_for_window();
    }

    // Whether nothing acts in the block unless an energy passes what it was given: then its samples may be made without
    // asking, if `stayed` is asked in the end. If that says no, nothing of them stands.
    bool may_stay() const { return rested_; }
    bool stayed() {
        if (!calm_.stays(lines_, fixed_forces_)) return false;
        forget();
        return true;
    }

    // Whether sample b is known to need nothing else than the port forces `now`, which are those without nonlinear ones.
    bool stays_still(int b, const double* now) {
        if (!still_) return false;
        using S = Simd;
        double* const taken = ws_.taken.data();
        bool below = !calm_.any() || calm_.meets(b, line_at(b), now);
        for (const int j : ws_.awake_list) below = below && clears(j, b, now, [](auto&&...) {});
        if (!calm_.all()) {
            const double* const worth = calm_.worth();
            for (int p = 0; p < layout_.force_width; p += S::width) {
                const S::V push = S::load(now + p);
                const S::V sum = S::load(taken + p) + S::load(worth + p) * (push < 0.0 ? -push : push);
                S::store(taken + p, sum);
            }
            for (int p = 0; p < layout_.force_width; ++p) below = below && taken[p] < 1.0;
        }
        if (below) {
            if (calm_.any()) calm_.commit();
            forget();
            return true;
        }
        still_ = false;
        for (int g = 0; g < int(nl_.groups.size()); ++g)
            for (int s = 0; s < b && !calm_[g]; ++s) ws_.level[g] += share_taken(g, s);
        return false;
    }

    // The same where tensions rise and energies leave out all contacts: whether the forces found for sample b may stand.
    bool rests(int b, const double* now) {
        if (!still_ || !calm_.meets(b, line_at(b), now)) return false;
        calm_.commit();
        forget();
        return true;
    }

    // All forces of sample b, for the motion that the lines tell; `commit` makes them stand. `f` (f_width) holds those of
    // the linear connections if there were no others; it takes what they are, and `now` the forces on all fixed ports.
    // False if the nonlinear ones were not found.
    bool forces(int b, double* f, double* now) {
        std::copy_n(f, layout_.f_width, ws_.f0.data());
        begin_sample(b);
        for (;;) {
            if (!ws_.active.empty() && !solve()) return false;
            combine(b, f, now);
            // a contact may be brought into touch by what has just been found: those that sleep are asked by their
            // bound, those awake by their motion; the set only grows
            wake_by(b);
            if (!add_touching()) break;
        }
        return true;
    }

    // Finds a step in which `solve` asks for the forces many times over: friction keeps to its branches meanwhile.
    template <class Solve>
    bool keeping_branches(const Solve& solve) {
        if (!nl_.k) return solve();
        std::fill(ws_.branch.begin(), ws_.branch.end(), Branch::open);
        ws_.sliding.clear();
        kept_ = true;
        const bool done = settle(nl_, ws_, solve);
        kept_ = false;
        return done;
    }

    // The forces of sample b stand: what they leave behind for the next. True if a nonlinear connection acts.
    bool commit(int b) {
        for (const int j : ws_.previous) ws_.last_force[j] = 0.0;
        double* forces = job_.law_forces + (start_ + b) * nl_.k;
        for (const int j : ws_.active) {
            forces[j] = ws_.last_force[j] = ws_.law_force[j];
            ws_.acted[j] = ws_.acted[j] || forces[j] != 0.0;
            if (nl_.laws[j].kind == Law::friction) ws_.slip[j] = ws_.slip_after[j];
            ws_.touching[j] = 0;
        }
        if (ws_.any_alive) move_series();
        if (calm_.any()) calm_.commit();
        std::swap(ws_.previous, ws_.active);
        for (std::size_t index = 0; index < nl_.groups.size(); ++index) ws_.level[index] = ws_.level_after[index];
        return !ws_.previous.empty();
    }

    // What the forces of sample b do to guarded rows, and guarded forces to all rows, in the rest of the block.
    void push_on(int b, const double* now) {
        if (!reads_ && !loads_) return;
        for (int i = 0; i < int(components_.size()); ++i) {
            if (tense(i)) continue;  // its rows are read anew each sample
            const Component& c = components_[i];
            const Guarded& g = c.guarded;
            for (const int p : ws_.loaded[i]) {
                const double force = ws_.force[std::size_t(nl_.first[i] + p) * kBlock + b];
                const double* h = g.on_rows.data() + std::size_t(p) * kBlock * c.n_rows;
                for (int k = 0; k < nb_ - b; ++k, h += c.n_rows) {
                    double* line = lines_ + std::size_t(b + 1 + k) * layout_.width + layout_.row[i];
                    for (int r = 0; r < c.n_rows; ++r) line[r] += h[r] * force;
                }
            }
            for (const int r : ws_.awake_rows[i]) {
                double* later = value(i, r) + b + 1;
                for (int p = 0; p < c.n_ports; ++p) respond_to_fixed(i, p, r, now[layout_.port[i] + p], later);
                for (const int p : ws_.loaded[i]) respond_to_guarded(i, p, r, b, later);
            }
        }
    }

    // Inputs of guarded ports for a component that is turned sample by sample.
    void add_inputs(int i, std::vector<Input>& inputs) const {
        if (!nl_.k) return;
        const Component& c = components_[i];
        for (const int p : ws_.loaded[i])
            inputs.push_back({c.guarded.w.data() + std::size_t(2 * p) * c.n,
                              ws_.force.data() + (std::size_t(nl_.first[i] + p) * kBlock), 1});
    }

    // The same for one that recurs through a whole block.
    void push_modes(int i, double* x, double* y) const {
        if (!nl_.k || ws_.loaded[i].empty()) return;
        const Guarded& g = components_[i].guarded;
        recur_store<false>(components_[i], x, y,
                              {g.w.data(), g.w_slope.data(), int(ws_.loaded[i].size()), ws_.loaded[i].data(),
                               ws_.force.data() + (std::size_t(nl_.first[i]) * kBlock), 1, kBlock});
    }

    // Adds the nonlinear forces that readouts hear.
    void emit(std::int64_t start, int nb) const {
        for (int b = 0; b < nb; ++b)
            for (const int j : nl_.heard) {
                const double f = job_.law_forces[(start + b) * nl_.k + j];
                for (int o = 0; o < job_.n_channels; ++o)
                    job_.out[(start + b) * job_.n_channels + o] += nl_.weights[std::size_t(o) * nl_.k + j] * f;
            }
    }

private:
    // Drives of sample b, and the connections that act in it as far as the motion before it tells.
    void begin_sample(int b) {
        open_sample(b);
        meet_awake(b);
    }

    void open_sample(int b) {
        for (int q = 0; q < job_.n_controls; ++q) {
            const Control& control = job_.controls[q];
            const int j = control.connection;
            const double* values = control.values + start_ + b;
            ws_.offset[j] = values[0], ws_.offset_after[j] = values[job_.n];
            ws_.velocity[j] = values[2 * job_.n], ws_.scale[j] = values[3 * job_.n];
        }
        sample_ = b;
        for (const int j : ws_.active) ws_.touching[j] = 0;  // of an attempt that did not stand
        ws_.active.clear();
    }

    void meet_awake(int b) {
        for (const int j : ws_.awake_list) {
            meet(j, b);
            if (!is_contact(j) || (ws_.old_p[j] > 0.0 && ws_.scale[j] > 0.0)) activate(j);
        }
    }

    // No nonlinear force acted in the sample before.
    void forget() {
        for (const int j : ws_.previous) ws_.last_force[j] = 0.0;
        ws_.previous.clear();
    }

    // Whether a connection is a contact of guarded ports alone.
    bool is_plain(int j) const {
        for (const Term& t : nl_.terms[j])
            if (!t.guarded) return false;
        return is_contact(j);
    }

    // Whether a plain contact touches nothing before and after sample b if no law acts in it, with room for rounding.
    // `tell(term, old, after, error)` takes off what a tense string is there.
    template <class Tell>
    bool clears(int j, int b, const double* now, const Tell& tell) const {
        double old = ws_.offset[j], after = ws_.offset_after[j], error = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const int i = t.component;
            if (tense(i)) {
                tell(t, old, after, error);
                continue;
            }
            const Guarded& g = components_[i].guarded;
            const double before = value(i, t.port)[b];
            double then = value(i, t.port)[b + 1];
            for (std::size_t p = 0; p < std::size_t(components_[i].n_ports); ++p)
                then += now[layout_.port[i] + p] * g.from_fixed[(p * g.n + t.port) * kBlock];
            old -= t.factor * before, after -= t.factor * then;
            error += kMargin * (std::abs(before) + std::abs(then));
        }
        return old < -error && after < -error;
    }

    bool tense(int i) const { return components_[i].stretched.on; }
    bool is_contact(int j) const { return nl_.laws[j].kind == Law::contact; }
    // A component's state, counted from where the means of known forces would hold it in this block, and a row there.
    const double* x_from(int i) const { return known_[i].empty() ? x(i) : calm_.moved(i); }
    const double* y_from(int i) const { return known_[i].empty() ? y(i) : calm_.moved(i) + components_[i].n; }
    double held_at(const Term& t) const {
        return known_[t.component].empty() ? 0.0 : calm_.held_at(nl_.first[t.component] + t.port);
    }
    const double* x(int i) const { return job_.modes[0] + components_[i].offset; }
    const double* y(int i) const { return job_.modes[1] + components_[i].offset; }
    double* value(int i, int port) const { return ws_.value.data() + (std::size_t(nl_.first[i] + port) * kStride); }
    const double* line_at(int b) const { return lines_ + std::size_t(b) * layout_.width; }
    const double* line_of(const Term& t) const { return lines_ + layout_.row[t.component] + t.port; }

    void mark_row(const Term& t) {
        char& awake = ws_.row_awake[nl_.first[t.component] + t.port];
        if (!awake) ws_.awake_rows[t.component].push_back(t.port);
        awake = 1, reads_ = reads_ || !tense(t.component);
    }

    // Free motion of guarded rows over the block.
    void read(int i, const int* list, int count) {
        const Component& c = components_[i];
        const Guarded& g = c.guarded;
        statistics_.rows_read += count;
        const Rows rows{g.rows.data(), g.slopes.data(), count, list, value(i, 0), 1, kStride};
        // neither reading moves the state
        double *sx = job_.modes[0] + c.offset, *sy = job_.modes[1] + c.offset;
        if (known_[i].empty() && nb_ == kBlock && g.n <= 2)
            recur_read(c, sx, sy, rows);
        else
            turn<true, false>(c, sx, sy, known_[i].data(), int(known_[i].size()), nb_, rows);
    }

    // No contact of a calm group need be looked at; without bounds all are, as a check on them.
    void rest(int index) {
        for (const int j : nl_.groups[index].contacts) ws_.awake[j] = !nl_.asleep_allowed;
        ws_.asleep[index] = 0, ws_.quiet[index] = 1, ws_.level[index] = ws_.level_after[index] = 0.0;
        if (!nl_.asleep_allowed)
            for (const int i : nl_.groups[index].components) follow(i);
    }

    // Whether a group on which known forces act is calm for a block; without bounds all contacts are looked at anyhow.
    bool calm_for_block(int index) {
        const Nonlinear::Group& group = nl_.groups[index];
        if (!group.calm || !bounded_ || !nl_.asleep_allowed || calm_.tense(index) || ws_.driven[index] ||
            moved_by_series(index))
            return false;
        for (const int i : group.components)
            if (!known_[i].empty()) return calm_.begin_block(index, job_, known_, nb_);
        return false;
    }

    // A group is calm no more from this block on: its contacts are seen to in the other way, as if they had been so
    // since the block began.
    void stir(int index, int b) {
        calm_.release(index), rested_ = still_ = false;
        for (const int i : nl_.groups[index].components) leave(i);
        if (!nl_.asleep_allowed) return;
        // stretched strings have left where the block began
        if (calm_.tense(index))
            for (const int j : nl_.groups[index].contacts) ws_.awake[j] = 1;
        else
            guard(index);
        ws_.quiet[index] = 0;
        sample_ = b;
        for (const int j : nl_.groups[index].contacts)
            if (ws_.awake[j]) wake(j, b);
        weigh(index);
    }

    // Stirs the groups that the forces tried in sample b could bring out of their calm.
    void stir_by(int b) {
        const double *line = line_at(b), *now = fixed_forces_ + std::size_t(b) * layout_.force_width;
        const bool meets = calm_.meets(b, line, now);
        if (meets && !ws_.any_alive) return;
        for (int g = 0; g < int(nl_.groups.size()); ++g)
            if (calm_[g] && (calm_.passed(g, line, now) || moved_by_series(g))) stir(g, b);
    }

    bool moved_by_series(int index) const {
        if (!ws_.any_alive) return false;
        for (const int j : nl_.groups[index].contacts)
            if (series_lives(j)) return true;
        return false;
    }

    void guard(int index) {
        const Nonlinear::Group& group = nl_.groups[index];
        bool held = false;
        for (const int i : group.components) {
            const Component& c = components_[i];
            if (!c.guarded.n) continue;
            ws_.added[i] = 0.0, ws_.sized[i] = 0;
            if (!known_[i].empty()) {
                const auto size = [&](const double* by) { return norm(c, by, by + c.n); };
                ws_.added[i] = calm_.settle_about(i, job_, known_[i], nb_, size);
                held = true;
            }
            ws_.norm[i] = norm(c, x_from(i), y_from(i));
        }
        double share = 0.0;
        if (group.simple)
            for (std::size_t q = 0; q < group.components.size(); ++q) {
                const int i = group.components[q];
                share += (ws_.norm[i] + ws_.added[i]) * group.tightest[q];
            }
        ws_.quiet[index] =
            group.simple && nl_.asleep_allowed && !ws_.driven[index] && !held && share * (1 + kMargin) < kQuiet;
        if (ws_.quiet[index]) {  // no contact need be looked at by itself
            for (const int j : group.contacts) ws_.awake[j] = 0, ws_.slack[j] = -(1 - kQuiet) * nl_.laws[j].offset;
            for (std::size_t q = 0; q < group.components.size(); ++q) {
                const int i = group.components[q];
                std::copy(group.worth[q].begin(), group.worth[q].end(), ws_.worth[i].begin());
                ws_.pull_worth[i] = group.pull_worth[q];
            }
            ws_.asleep[index] = int(group.contacts.size());
            ws_.level[index] = 0.0;
            return;
        }
        for (const int j : group.contacts) {
            double slack = -1.0;
            if (nl_.asleep_allowed) {
                slack = far_slack(j);
                if (!(slack > 0.0)) slack = near_slack(j);
            }
            ws_.slack[j] = slack;
            ws_.awake[j] = !(slack > 0.0);
        }
    }

    // Clearance left by |row| <= peak norm.
    double far_slack(int j) const {
        double most = 0.0;
        for (const Term& t : nl_.terms[j]) {
            double bound = 0.0;
            if (t.guarded)
                bound = components_[t.component].guarded.peak[t.port] * (ws_.norm[t.component] + ws_.added[t.component]) +
                        std::abs(held_at(t));
            else
                for (int b = 0; b <= nb_; ++b)
                    bound = std::max(bound, std::abs(line_of(t)[std::size_t(b) * layout_.width]));
            most += std::abs(t.factor) * bound;
        }
        return -ws_.clearance[j] - most * (1 + kMargin);
    }

    // Clearance left by the gap's value in the middle of the block and what may happen around it.
    double near_slack(int j) {
        double low = 0.0, all = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const double size = std::abs(t.factor);
            if (t.guarded) {
                const int i = t.component;
                const double peak = components_[i].guarded.peak[t.port];
                Surroundings around = surroundings(components_[i], t.port, x_from(i), y_from(i), sizes_of(i));
                around.middle += held_at(t);
                const double far = around.spread + peak * ws_.added[i];
                low += t.factor * around.middle - size * far;
                all += size * (std::abs(around.middle) + std::abs(held_at(t)) + far + peak * ws_.norm[i]);
            } else {
                double least = t.factor * line_of(t)[0];
                for (int b = 1; b <= nb_; ++b)
                    least = std::min(least, t.factor * line_of(t)[std::size_t(b) * layout_.width]);
                low += least;
                all += std::abs(least);
            }
        }
        return low - ws_.clearance[j] - kMargin * (all + std::abs(ws_.clearance[j]));
    }

    // Sizes of a component's modes at the beginning of the block, made once.
    const double* sizes_of(int i) {
        double* buffer = ws_.sizes.data() + components_[i].offset;
        if (!ws_.sized[i]) sizes(components_[i], x_from(i), y_from(i), buffer);
        ws_.sized[i] = 1;
        return buffer;
    }

    // What a newton at each port takes of the tightest slack of a group's sleepers, and what the forces before this
    // sample have taken. Ports that are not pushed in this block take nothing.
    void weigh(int index) {
        const Nonlinear::Group& group = nl_.groups[index];
        for (const int i : group.components) {
            std::fill(ws_.worth[i].begin(), ws_.worth[i].end(), 0.0);
            ws_.pull_worth[i] = 0.0;
        }
        ws_.asleep[index] = 0;
        for (const int j : group.contacts) {
            if (ws_.awake[j]) continue;
            ++ws_.asleep[index];
            for (const Term& t : nl_.terms[j]) {
                const double share = std::abs(t.factor) / ws_.slack[j], *reach = reach_of(t);
                double* worth = ws_.worth[t.component].data();
                each_port(t.component, [&](int p) { worth[p] = std::max(worth[p], share * reach[p]); });
                if (tense(t.component)) {
                    double& worth_of_pull = ws_.pull_worth[t.component];
                    worth_of_pull = std::max(worth_of_pull, share * components_[t.component].guarded.pulled[t.port]);
                }
            }
        }
        ws_.level[index] = 0.0;
        for (int b = 0; b < sample_; ++b) ws_.level[index] += share_taken(index, b);
    }

    const double* reach_of(const Term& t) const {
        const Component& c = components_[t.component];
        const std::size_t port = t.guarded ? c.n_ports + t.port : t.port;
        return c.guarded.reach.data() + (port * (c.n_ports + c.guarded.n));
    }

    // Calls visit(port among all of the component) for every port that takes part in this block.
    template <class Visit>
    void each_port(int i, const Visit& visit) const {
        const int n_ports = components_[i].n_ports;
        for (int p = 0; p < n_ports; ++p) visit(p);
        for (const int p : ws_.loaded[i]) visit(n_ports + p);
    }

    // |force| in sample b on a port among all of a component.
    double pushed(int i, int p, int b) const {
        const int n_ports = components_[i].n_ports;
        return std::abs(p < n_ports
                            ? fixed_forces_[std::size_t(b) * layout_.force_width + layout_.port[i] + p]
                            : ws_.force[std::size_t(nl_.first[i] + p - n_ports) * kBlock + b]);
    }

    // Share of the tightest slack of a group that the forces of sample b take.
    double share_taken(int index, int b) const {
        double sum = 0.0;
        for (const int i : nl_.groups[index].components) {
            each_port(i, [&](int p) { sum += ws_.worth[i][p] * pushed(i, p, b); });
            if (tense(i)) sum += ws_.pull_worth[i] * ws_.pull[std::size_t(i) * kBlock + b];
        }
        return sum;
    }

    // Wakes contacts that the forces tried in sample b could have brought into touch.
    void wake_by(int b) {
        if (calm_.any()) stir_by(b);
        const double farthest = ws_.any_alive ? find_series() : 0.0;
        for (int index = 0; index < int(nl_.groups.size()); ++index) {
            if (!ws_.asleep[index]) continue;
            const Nonlinear::Group& group = nl_.groups[index];
            ws_.level_after[index] = ws_.level[index] + share_taken(index, b);
            double yielding = 0.0;
            // one bound for all sleeping contacts first
            if (ws_.any_alive && ws_.level_after[index] + farthest / ws_.least_slack[index] * (1 + kMargin) >= 1.0)
                for (const int j : group.contacts)
                    if (!ws_.awake[j] && series_lives(j)) {
                        const double most = std::max(std::abs(ws_.series[j]), std::abs(ws_.series_after[j]));
                        if (most > yielding * ws_.slack[j]) yielding = most / ws_.slack[j];
                    }
            if (ws_.level_after[index] + yielding * (1 + kMargin) < 1.0) continue;
            bool woken = false;
            press(index, b);
            for (const int j : group.contacts) {
                if (ws_.awake[j] || used(j) < ws_.slack[j]) continue;
                wake(j, b);
                woken = true;
            }
            if (!woken) continue;
            weigh(index);
            ws_.level_after[index] = ws_.level[index] + share_taken(index, b);
        }
    }

    // Sums of |force| on the ports of a group until now, those of sample b as tried, and of pulls.
    void press(int index, int b) {
        for (const int i : nl_.groups[index].components) {
            double* const pressed = pressed_.data() + pressed_at_[i];
            each_port(i, [&](int p) {
                double& sum = pressed[p] = 0.0;
                for (int s = 0; s <= b; ++s) sum += pushed(i, p, s);
            });
            if (!tense(i)) continue;
            double& sum = pressed[components_[i].n_ports + components_[i].guarded.n] = 0.0;
            for (int s = 0; s <= b; ++s) sum += ws_.pull[std::size_t(i) * kBlock + s];
        }
    }

    // How far these may have moved a sleeping contact.
    double used(int j) const {
        double total = 0.0;
        for (const Term& t : nl_.terms[j]) {
            const Component& c = components_[t.component];
            const double *reach = reach_of(t), *pressed = pressed_.data() + pressed_at_[t.component];
            double sum = 0.0;
            each_port(t.component, [&](int p) { sum += reach[p] * pressed[p]; });
            if (tense(t.component)) sum += c.guarded.pulled[t.port] * pressed[c.n_ports + c.guarded.n];
            total += std::abs(t.factor) * sum;
        }
        if (series_lives(j)) total += std::max(std::abs(ws_.series[j]), std::abs(ws_.series_after[j]));
        return total * (1 + kMargin);
    }

    // Reads a contact's rows from the beginning of the block up to sample b, as if they had been awake all along.
    void wake(int j, int b) {
        ++statistics_.woken;
        ws_.awake[j] = 1, plain_ = plain_ && is_plain(j);
        ws_.awake_list.insert(std::upper_bound(ws_.awake_list.begin(), ws_.awake_list.end(), j), j);
        for (const Term& t : nl_.terms[j]) {
            if (!t.guarded || ws_.row_awake[nl_.first[t.component] + t.port]) continue;
            mark_row(t);
            const int i = t.component;
            if (tense(i)) continue;
            read(i, &t.port, 1);
            for (int s = 0; s < b; ++s) {
                double* later = value(i, t.port) + s + 1;
                const double* then = fixed_forces_ + std::size_t(s) * layout_.force_width;
                for (int p = 0; p < components_[i].n_ports; ++p)
                    respond_to_fixed(i, p, t.port, then[layout_.port[i] + p], later);
                for (const int p : ws_.loaded[i]) respond_to_guarded(i, p, t.port, s, later);
            }
        }
        meet(j, b);
    }

    void respond_to_fixed(int i, int p, int row, double force, double* later) const {
        const Guarded& g = components_[i].guarded;
        add_response(g.from_fixed.data() + ((std::size_t(p) * g.n + row) * kBlock), force, later);
    }
    void respond_to_guarded(int i, int p, int row, int b, double* later) const {
        const Guarded& g = components_[i].guarded;
        add_response(g.from_guarded.data() + ((std::size_t(p) * g.n + row) * kBlock),
                     ws_.force[std::size_t(nl_.first[i] + p) * kBlock + b], later);
    }
    static void add_response(const double* h, double force, double* later) {
        for (int k = 0; k < kBlock; ++k) later[k] += h[k] * force;
    }

    // A guarded port of a stretched string as it is now.
    double read_now(const Term& t) const {
        using S = Simd;
        const Component& c = components_[t.component];
        const double* row = c.guarded.rows.data() + 2 * std::size_t(t.port) * c.n;
        taut_.tell(t.component);
        const double *sx = x(t.component), *sy = y(t.component);
        S::V sum{}, more{};
        for (int k = 0; k < c.n; k += S::width) {
            sum += S::load(row + k) * S::load(sx + k);
            more += S::load(row + c.n + k) * S::load(sy + k);
        }
        return S::sum(sum + more);
    }

    // Compressions of a connection before the step, and after it without nonlinear forces; where strings are tense,
    // what the others leave of the latter, in rest_p.
    void meet(int j, int b) {
        double gap = 0.0, free = 0.0;
        for (const Term& t : nl_.terms[j]) {
            if (tense(t.component)) {
                gap += t.factor * (t.guarded ? read_now(t) : line_of(t)[std::size_t(b) * layout_.width]);
                continue;
            }
            const double* at = t.guarded ? value(t.component, t.port) + b : line_of(t) + std::size_t(b) * layout_.width;
            gap += t.factor * at[0], free += t.factor * at[t.guarded ? 1 : layout_.width];
        }
        const double* row = nl_.from_linear.data() + std::size_t(j) * m_;
        if (!any_tense_) free += dot(row, ws_.f0.data(), m_);
        if (nl_.series[j] >= 0) {
            gap += ws_.series[j];
            free -= (1 - nl_.theta) / nl_.theta * ws_.series[j];
        }
        ws_.old_p[j] = ws_.offset[j] - gap, ws_.free_p[j] = ws_.rest_p[j] = ws_.offset_after[j] - free;
        ws_.size[j] = std::max({std::abs(gap), std::abs(free), std::abs(ws_.offset_after[j])});
    }

    void activate(int j) {
        if (!ws_.known[j]) know(j);
        ws_.touching[j] = 1;
        ws_.active.push_back(j);
        ws_.law_force[j] = ws_.last_force[j];
    }

    // What connection j calls up in the linear ones, and what it moves with them: few of all contacts ever act.
    void know(int j) {
        const std::size_t width = layout_.f_width, k = nl_.k;
        double* const answer = ws_.answer.data() + j * width;
        const double* const moved = nl_.to_linear.data() + j * width;
        for (int i = 0; i < m_; ++i) answer[i] = dot(solve_.g.data() + std::size_t(i) * m_, moved, m_);
        for (std::size_t i = 0; i < k; ++i)
            ws_.z[i * k + j] = nl_.compliance[i * k + j] - dot(nl_.from_linear.data() + i * m_, answer, m_);
        ws_.known[j] = 1;
    }

    bool solve() {
        const auto find = [&] {
            int iterations = 0;
            const bool done = find_forces(nl_, ws_, ws_.z.data(), iterations);
            return found(done, iterations);
        };
        const bool done = kept_ ? find() : settle(nl_, ws_, find);
        statistics_.failures += !done;
        return done;
    }

    // Books a solve.
    bool found(bool done, int iterations) {
        ++statistics_.solves;
        statistics_.iterations += iterations;
        statistics_.most_iterations = std::max<std::int64_t>(statistics_.most_iterations, iterations);
        for (const int j : ws_.active)
            if (nl_.series[j] >= 0 && ws_.law_force[j] != 0.0) ws_.series_alive[nl_.series[j]] = ws_.any_alive = true;
        return done;
    }

    // Contacts that the motion found brings into touch join the active ones; true if there are any.
    bool add_touching() {
        const std::size_t before = ws_.active.size();
        return add_touching(before, [&](int j) {
            double p = ws_.free_p[j];
            for (std::size_t q = 0; q < before; ++q)
                p -= ws_.z[std::size_t(j) * nl_.k + ws_.active[q]] * ws_.law_force[ws_.active[q]];
            return p;
        });
    }

    template <class After>
    bool add_touching(std::size_t before, const After& compression_after) {
        for (const int j : ws_.awake_list) {
            if (ws_.touching[j] || !is_contact(j) || !(ws_.scale[j] > 0.0)) continue;
            if (compression_after(j) > 0.0) activate(j);
        }
        if (ws_.active.size() == before) return false;
        std::sort(ws_.active.begin(), ws_.active.end());
        return true;
    }

    // Linear forces and port forces of sample b under the nonlinear forces tried.
    void combine(int b, double* f, double* now) {
        std::copy_n(ws_.f0.data(), layout_.f_width, f);
        for (const int j : ws_.active) {
            const double force = ws_.law_force[j], *answer = ws_.answer.data() + std::size_t(j) * layout_.f_width;
            for (int k = 0; k < layout_.f_width; ++k) f[k] -= answer[k] * force;
        }
        distribute(b, f, now);
    }

    // No nonlinear connection acts in sample b.
    void let_go(int b) {
        if (!loads_) return;
        for (std::size_t i = 0; i < components_.size(); ++i)
            for (const int p : ws_.loaded[i]) ws_.force[std::size_t(nl_.first[i] + p) * kBlock + b] = 0.0;
    }

    // Port forces of sample b.
    void distribute(int b, const double* f, double* now) {
        std::fill_n(now, layout_.force_width, 0.0);
        add_product(layout_.push.data(), layout_.force_width, f, m_, now);
        let_go(b);
        for (const int j : ws_.active) {
            const double force = ws_.law_force[j];
            for (const Term& t : nl_.driven[j]) now[layout_.port[t.component] + t.port] += t.factor * force;
            for (const Term& t : nl_.terms[j]) {
                if (!t.guarded) {
                    now[layout_.port[t.component] + t.port] += t.factor * force;
                } else if (force != 0.0) {
                    load(t);
                    ws_.force[std::size_t(nl_.first[t.component] + t.port) * kBlock + b] += t.factor * force;
                }
            }
        }
    }

    // A guarded port takes part in this block from now on.
    void load(const Term& t) {
        const int port = nl_.first[t.component] + t.port;
        if (ws_.is_loaded[port]) return;
        ws_.is_loaded[port] = 1, loads_ = true;
        std::fill_n(ws_.force.data() + std::size_t(port) * kBlock, kBlock, 0.0);
        auto& list = ws_.loaded[t.component];
        list.insert(std::upper_bound(list.begin(), list.end(), t.port), t.port);
        if (const int group = nl_.group_of[t.component]; group >= 0) {
            if (calm_[group]) stir(group, sample_);
            weigh(group);
        }
    }

    // Displacements of the residual compliances after the step, under the forces tried; the largest one, before or after.
    double find_series() {
        const double old = (1 - nl_.theta) / nl_.theta, per = 1 / nl_.theta;
        const int k = nl_.k;
        const double* const __restrict before = ws_.series.data();
        double* const __restrict after = ws_.series_after.data();
        for (int j = 0; j < k; ++j) after[j] = -old * before[j];
        for (const int q : ws_.active) {  // a force moves its own group and nothing else
            if (!series_lives(q)) continue;
            const double push = per * ws_.law_force[q];
            const double* const __restrict row = nl_.residual.data() + std::size_t(q) * k;
            for (int j = 0; j < k; ++j) after[j] += row[j] * push;
        }
        double farthest = 0.0;
        for (int j = 0; j < k; ++j) farthest = std::max({farthest, std::abs(before[j]), std::abs(after[j])});
        return farthest;
    }

    bool series_lives(int j) const { return nl_.series[j] >= 0 && ws_.series_alive[nl_.series[j]]; }

    void move_series() {
        ws_.any_alive = false;
        for (int s = 0; s < nl_.n_series; ++s) {
            if (!ws_.series_alive[s]) continue;
            double most = 0.0;
            for (const int j : nl_.in_series[s]) most = std::max(most, std::abs(ws_.series_after[j]));
            const bool still = most < kStillSeries;
            for (const int j : nl_.in_series[s]) ws_.series[j] = still ? 0.0 : ws_.series_after[j];
            ws_.series_alive[s] = !still;
            ws_.any_alive = ws_.any_alive || !still;
        }
    }

    const std::vector<Component>& components_;
    const Layout& layout_;
    const Solve& solve_;
    const int m_;
    const Nonlinear& nl_;
    Workspace& ws_;
    Statistics& statistics_;
    const Job& job_;
    const std::vector<std::vector<Input>>& known_;
    Taut& taut_;
    bool any_tense_ = false, kept_ = false, still_ = false, rested_ = false, bounded_ = false;
    // of the block: whether guarded rows are read throughout, and pushed at; whether all that is awake is_plain
    bool reads_ = false, loads_ = false, plain_ = false;
    // by component, at `pressed_at_`: sums of |force| on its ports, then of its pulls
    std::vector<int> pressed_at_;
    Array<double> pressed_;
    std::int64_t start_ = 0;
    int nb_ = 0, sample_ = 0;
    double* lines_ = nullptr;
    const double* fixed_forces_ = nullptr;
    Calm calm_;
};

}  // namespace
}  // namespace tonewood
