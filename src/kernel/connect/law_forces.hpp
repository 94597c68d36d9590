// Forces of the nonlinear connections, sample by sample, and their state that the next sample needs.
//
// The linear connections are eliminated: z holds the gaps per force of a law with the linear connections answering. The
// active set grows from the candidates that are closed before the step to those that the motion found closes.
#pragma once

#include "../cull/broad_phase.hpp"
#include "laws/solve.hpp"
#include "laws_under_potentials.hpp"
#include "parts.hpp"
#include "series.hpp"

namespace tonewood {
namespace {

class LawForces {
    using Term = Nonlinear::Term;

public:
    // `potentials`: null without any.
    LawForces(Block& block, ForcesInParts& parts, ContactRows& rows, BroadPhase& cull, Series& series,
              PotentialSolve* potentials)
        : block_(block), parts_(parts), rows_(rows), cull_(cull), series_(series),
          potentials_(block, parts, potentials), layout_(block.model.layout), solve_(block.model.solve),
          nl_(block.model.nonlinear), ws_(block.space.contacts), statistics_(block.space.statistics), job_(block.job) {
        if (!nl_.k) return;
        std::copy_n(job_.slip, nl_.k, ws_.slip.data());
        std::copy_n(job_.last_force, nl_.k, ws_.last_force.data());
        std::fill(ws_.is_active.begin(), ws_.is_active.end(), 0), std::fill(ws_.acted.begin(), ws_.acted.end(), 0);
        series_.begin(job_.series);
        ws_.gathered.clear(), ws_.previous.clear(), ws_.active.clear();
        for (int j = 0; j < nl_.k; ++j) {
            ws_.offset[j] = ws_.offset_after[j] = nl_.laws[j].offset;
            ws_.velocity[j] = nl_.laws[j].velocity, ws_.scale[j] = 1.0;
            if (ws_.last_force[j] != 0.0) ws_.previous.push_back(j);
        }
    }

    bool any() const { return nl_.k > 0; }

    // Writes the state back.
    void finish() {
        if (!nl_.k) return;
        series_.finish(job_.series);
        std::copy_n(ws_.slip.data(), nl_.k, job_.slip);
        std::copy_n(ws_.last_force.data(), nl_.k, job_.last_force);
    }

    // Finds all forces of sample b for the motion in the row history. `f` (f_width) holds the forces of the linear
    // connections without laws; it takes the forces found, and `now` those on all fixed ports. False if they were not
    // found. `commit` makes them final. Kept out of the flattened functions that call it: inlined into them it made
    // three fifths of the time that the kernel takes to compile, and none of its speed.
    __attribute__((noinline)) bool forces(int b, double* f, double* now) {
        std::copy_n(f, layout_.f_width, ws_.f0.data());
        open_sample(b);
        compress_candidates(b);
        for (;;) {
            if (!ws_.active.empty() && !solve()) return false;
            combine(b, f, now);
            // the forces found may close more contacts: culled ones are tested by their bound, candidates by their
            // motion
            cull_.add_candidates(b, series_.find(), [&](int j) { compress(j, b); });
            if (!activate_closed([&](int j) { return compression_after(j); })) break;
        }
        return true;
    }

    // The forces of sample b are final; whether a nonlinear connection acts.
    bool commit(int b) {
        if (!nl_.k) return false;
        for (const int j : ws_.previous) ws_.last_force[j] = 0.0;
        double* forces = job_.law_forces + (block_.start + b) * nl_.k;
        for (const int j : ws_.active) {
            forces[j] = ws_.last_force[j] = ws_.law_force[j];
            ws_.acted[j] = ws_.acted[j] || forces[j] != 0.0;
            if (!nl_.laws[j].has_potential()) ws_.slip[j] = ws_.slip_after[j];
            ws_.is_active[j] = 0;
        }
        series_.commit();
        std::swap(ws_.previous, ws_.active);
        ws_.active.clear();
        cull_.commit();
        return !ws_.previous.empty();
    }

    // No nonlinear connection acts in the sample.
    void commit_contact_free() {
        for (const int j : ws_.previous) ws_.last_force[j] = 0.0;
        ws_.previous.clear();
    }

    // Adds the nonlinear forces that are outputs.
    void add_outputs() const {
        for (int b = 0; b < block_.nb; ++b)
            for (const int j : nl_.read_forces) {
                const double f = job_.law_forces[(block_.start + b) * nl_.k + j];
                for (int o = 0; o < job_.n_channels; ++o)
                    job_.out[(block_.start + b) * job_.n_channels + o] += nl_.weights[std::size_t(o) * nl_.k + j] * f;
            }
    }

    // Sets the values that controls give the laws in sample b; no law is active yet.
    void open_sample(int b) {
        for (const Control& control : job_.controls) {
            const int j = control.connection;
            const double* values = control.values + block_.start + b;
            ws_.offset[j] = values[0], ws_.offset_after[j] = values[job_.n];
            ws_.velocity[j] = values[2 * job_.n], ws_.scale[j] = values[3 * job_.n];
        }
        give_up();
    }

    // Compressions of all candidates; laws other than contacts, and closed contacts, become active.
    void compress_candidates(int b) {
        for (const int j : cull_.candidates()) {
            compress(j, b);
            if (!is_contact(j) || (ws_.old_p[j] > 0.0 && ws_.scale[j] > 0.0)) activate(j);
        }
    }

    // Compressions of a connection before the step, and after it without nonlinear forces.
    void compress(int j, int b) {
        double gap = 0.0, free = 0.0;
        for (const Term& t : nl_.terms[j]) {
            double* const at =
                t.contact ? rows_.value(t.component, t.port) + b : rows_.line_of(t) + std::size_t(b) * layout_.width;
            if (potentials_.on()) potentials_.displace(t, at);
            gap += t.factor * at[0], free += t.factor * at[t.contact ? 1 : layout_.width];
        }
        free += dot(nl_.from_linear.data() + std::size_t(j) * solve_.m, ws_.f0.data(), solve_.m);
        if (potentials_.on()) free -= potentials_.moved(j);
        if (nl_.series[j] >= 0) {
            gap += ws_.series[nl_.place[j]];
            free -= (1 - nl_.theta) / nl_.theta * ws_.series[nl_.place[j]];
        }
        ws_.old_p[j] = ws_.offset[j] - gap, ws_.free_p[j] = ws_.offset_after[j] - free;
        ws_.size[j] = std::max({std::abs(gap), std::abs(free), std::abs(ws_.offset_after[j])});
    }

    // Counts a solve; groups of residual compliances on which a force acts move from now on.
    bool count(bool done, int iterations) {
        ++statistics_.solves;
        statistics_.iterations += iterations;
        statistics_.most_iterations = std::max<std::int64_t>(statistics_.most_iterations, iterations);
        for (const int j : ws_.active)
            if (ws_.law_force[j] != 0.0) series_.start(j);
        return done;
    }

    // Candidates that `compression_after` finds closed after the step become active; whether there are any.
    template <class After>
    bool activate_closed(const After& compression_after) {
        const std::size_t before = n_before_ = ws_.active.size();
        for (const int j : cull_.candidates()) {
            if (ws_.is_active[j] || !is_contact(j) || !(ws_.scale[j] > 0.0)) continue;
            if (compression_after(j) > 0.0) activate(j);
        }
        if (ws_.active.size() == before) return false;
        std::sort(ws_.active.begin(), ws_.active.end());
        return true;
    }

    // Port forces of sample b from those of the linear connections and the active laws.
    void distribute(int b, const double* f, double* now) {
        if (parts_.on()) {
            parts_.scatter(f, now);
        } else {
            std::fill_n(now, layout_.force_width, 0.0);
            add_product(layout_.scatter.data(), layout_.force_width, f, solve_.m, now);
        }
        rows_.clear_forces(b);
        for (const int j : ws_.active) {
            const double force = ws_.law_force[j];
            for (const Term& t : nl_.driven[j]) now[layout_.port[t.component] + t.port] += t.factor * force;
            for (const Term& t : nl_.terms[j]) {
                if (!t.contact) {
                    now[layout_.port[t.component] + t.port] += t.factor * force;
                } else if (force != 0.0) {
                    if (rows_.load(t)) cull_.port_loaded(t.component, b);
                    rows_.force(t.component, t.port)[b] += t.factor * force;
                }
            }
        }
    }

    // Forces on contact ports of component i in sample b.
    std::vector<std::pair<int, double>> loads(int i, int b) const {
        std::vector<std::pair<int, double>> out;
        if (!nl_.k || !rows_.loads()) return out;
        for (const int p : ws_.loaded[i])
            if (const double force = rows_.force(i, p)[b]; force != 0.0) out.emplace_back(p, force);
        return out;
    }

    // Whether no law can act in sample b: no candidate, and none added by the port forces that `set` writes.
    template <class Set>
    bool idle(int b, const Set& set) {
        if (!cull_.candidates().empty()) return false;
        set();
        return commit_alone(b, {}, nullptr);
    }

    // Makes forces of these laws alone final in sample b, whose port forces are written; false, with nothing made, if a
    // culled contact could touch.
    bool commit_alone(int b, const std::vector<int>& laws, const double* force) {
        give_up();
        rows_.clear_forces(b);
        ws_.active.assign(laws.begin(), laws.end());
        for (std::size_t i = 0; i < laws.size(); ++i) {
            ws_.law_force[laws[i]] = force[i];
            if (force[i] != 0.0) series_.start(laws[i]);
        }
        if (cull_.any_culled()) potentials_.bound_excursions(b);
        const std::size_t before = cull_.candidates().size();
        cull_.add_candidates(b, series_.find(), [](int) {});
        if (cull_.candidates().size() != before) return false;
        statistics_.solves += !laws.empty();
        commit(b);
        return true;
    }

    // Derives the response to connection j, which it needs to act.
    void need_response(int j) {
        if (!ws_.has_response[j]) find_response(j);
    }

private:
    // No law is active yet, whatever was tried.
    void give_up() {
        for (const int j : ws_.active) ws_.is_active[j] = 0;
        ws_.active.clear();
    }

    bool is_contact(int j) const { return nl_.laws[j].one_sided(); }

    void activate(int j) {
        need_response(j);
        ws_.is_active[j] = 1;
        ws_.active.push_back(j);
        ws_.law_force[j] = ws_.last_force[j];
    }

    // Response of the linear connections and of all gaps to connection j, derived when it first acts.
    void find_response(int j) {
        const std::size_t width = layout_.f_width, k = nl_.k, m = solve_.m;
        double* const answer = ws_.answer.data() + j * width;
        const double* const moved = nl_.to_linear.data() + j * width;
        if (parts_.on())
            parts_.answer(moved, answer);
        else
            for (std::size_t i = 0; i < m; ++i) answer[i] = dot(solve_.g.data() + i * m, moved, int(m));
        for (std::size_t i = 0; i < k; ++i)
            ws_.z[i * k + j] = nl_.compliance[i * k + j] - dot(nl_.from_linear.data() + i * m, answer, int(m));
        ws_.has_response[j] = 1;
    }

    bool solve() {
        const double* const z = potentials_.on() ? potentials_.yield() : ws_.z.data();
        const auto find = [&] {
            int iterations = 0;
            const bool done = find_forces(nl_, ws_, z, iterations);
            return count(done, iterations);
        };
        const bool done = converge_branches(nl_, ws_, find);
        statistics_.failures += !done;
        return done;
    }

    // Compression of j after the step under the forces found.
    double compression_after(int j) const {
        double p = ws_.free_p[j];
        for (std::size_t q = 0; q < n_before_; ++q) {
            const double yielded = potentials_.on() ? potentials_.yielded(j, q) : 0.0;
            p -= (ws_.z[std::size_t(j) * nl_.k + ws_.active[q]] - yielded) * ws_.law_force[ws_.active[q]];
        }
        return p;
    }

    // Forces of the linear connections and of the ports under the nonlinear forces tried.
    void combine(int b, double* f, double* now) {
        std::copy_n(ws_.f0.data(), layout_.f_width, f);
        for (const int j : ws_.active) {
            const double force = ws_.law_force[j], *answer = ws_.answer.data() + std::size_t(j) * layout_.f_width;
            for (int k = 0; k < layout_.f_width; ++k) f[k] -= answer[k] * force;
        }
        if (potentials_.on()) potentials_.add_means(b, f);
        distribute(b, f, now);
    }

    Block& block_;
    ForcesInParts& parts_;
    ContactRows& rows_;
    BroadPhase& cull_;
    Series& series_;
    LawsUnderPotentials potentials_;
    const Layout& layout_;
    const Solve& solve_;
    const Nonlinear& nl_;
    ContactState& ws_;
    Statistics& statistics_;
    const Job& job_;
    std::size_t n_before_ = 0;
};

}  // namespace
}  // namespace tonewood
