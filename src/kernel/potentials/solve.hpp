// Potentials over one step, of any kinds side by side; the equations are in tonewood.physics.coupling.potentials.solve.
//
// A potential acts along a direction g that is known before the forces are, by -psi_m g, and psi_m answers to the
// motion along g as a linear connection does. So every sample is linear in psi_m, one unknown for each potential:
//     M psi_m = psi + g . (y_free - y) / 2 + C f / 2,      M = I + G / 2 + C K C^T / 2 >= I,
// G = g . w g its own motion along g, C the ports' motion per psi_m, f the forces of the linear connections without
// potentials, K those forces per displacement of the ports.
#pragma once

#include <memory>

#include "../connect/dense.hpp"
#include "../connect/parts.hpp"
#include "../modal/block.hpp"
#include "../modal/tension_pass.hpp"

namespace tonewood {
namespace {

constexpr double kPaidAtOnce = 0.25;   // of the kinetic energy, at most, where psi is put back
constexpr double kSame = 1e-13;        // of an energy, by which two sums of it may differ

class PotentialGroup;

// A component on which a potential acts.
struct PotentialPart {
    const Potentials::Part* part;
    const Component* c;
    double* state;             // modal/scaled_modes.hpp
    const double* known;       // what known forces add to the middle of the step (modal/tension_pass.hpp); null: nothing
    PotentialGroup* group;
    bool pending;              // its last step is made when the next one begins: its modes are in the cache once
    bool is_read, is_grouped;  // it has readouts; contacts on it are culled by its state
};

// What all potentials share in a run.
struct PotentialRun {
    Block& block;
    const Potentials& t;
    PotentialState& ws;
    ScaledModes scaled;
    std::vector<PotentialPart> parts;  // potential by potential
    std::vector<int> part_of;          // by component

    explicit PotentialRun(Block& b)
        : block(b), t(b.model.potentials), ws(b.space.potentials), scaled(b.model.components, ws, b.job),
          part_of(b.model.components.size(), -1) {
        const Nonlinear& nl = b.model.nonlinear;
        for (const Potentials::Part& part : t.parts) {
            const Component& c = b.model.components[part.component];
            part_of[part.component] = int(parts.size());
            parts.push_back({&part, &c, scaled.state(part.component), nullptr, nullptr, false, c.n_rows > c.n_ports,
                             nl.k && nl.group_of[part.component] >= 0});
        }
    }
};

// The potentials of one kind: first .. end among all.
class PotentialGroup {
public:
    PotentialGroup(PotentialRun& run, int first, int end)
        : run_(run), block_(run.block), components_(run.block.model.components), t_(run.t), ws_(run.ws), first_(first),
          end_(end) {}
    virtual ~PotentialGroup() = default;

    virtual void begin_step() {}
    // Modal passes over a component: sums of the step that begins, lanes of which go to `to`; the step.
    virtual void sum(const PotentialPart& part, double* to) = 0;
    virtual void make(const PotentialPart& part) = 0;
    // Both in one pass, of a component without known forces in either step; false, with nothing done, if it cannot.
    virtual bool advance(const PotentialPart&, double*) { return false; }
    // Displacements of the ports by fast coordinates to ws.pulled; whether there are any.
    virtual bool pull() { return false; }
    // Finds ws.own, and ws.reach and the right sides of the equations in ws.alone, from the sums and ws.driven.
    virtual void direct() = 0;
    // psi_m is final.
    virtual void end_step() = 0;
    // V in the state of the run.
    virtual double energy(int s) = 0;
    // C, of which `kept` is that of the steps before, 0 to choose it, and V is stored as `stored`.
    virtual double shift(int, double, double) { return 0.0; }
    // Takes an energy from the kinetic energy of the modes; returns the part that was paid.
    virtual double pay(int s, double cost) = 0;
    // Of V + C: excess of psi^2 / 2 up to which psi is not put back.
    virtual double tolerance() const { return 1e-3; }

    // Reads C and psi of all potentials from the state, whose numbers are the excess of psi^2 / 2 - C over V, C, and
    // psi.
    void begin() {
        for (int s = first_; s < end_; ++s) {
            const double *const kept = row(s), stored = energy(s) + kept[0], C = shift(s, kept[1], stored);
            const double apart = std::abs(0.5 * kept[2] * kept[2] - C - stored);
            const bool same = C == kept[1] && apart <= kSame * (std::abs(stored) + std::abs(kept[0]) + C);
            ws_.shift[s] = C;
            // near zero the root would not be as exact
            ws_.psi[s] =
                same ? kept[2] : std::copysign(std::sqrt(2 * std::max(stored + C, 0.0)), kept[2]);
        }
    }
    // Writes them; the modes are in the state. Puts psi back where it `resets`.
    void keep(bool resets) {
        for (int s = first_; s < end_; ++s) {
            const double value = energy(s);
            double excess = 0.5 * ws_.psi[s] * ws_.psi[s] - ws_.shift[s] - value;
            if (resets) {
                if (std::abs(excess) > tolerance() * (value + ws_.shift[s])) excess += pay(s, -excess);
                ws_.shift[s] = shift(s, 0.0, value + excess);
                ws_.psi[s] = std::sqrt(2 * std::max(value + excess + ws_.shift[s], 0.0));
            }
            row(s)[0] = excess, row(s)[1] = ws_.shift[s], row(s)[2] = ws_.psi[s];
        }
    }
    // Largest psi_m sqrt(sum g^2 / a) of component i in the sample, where contacts on it are culled.
    virtual double excursion(int) const { return 0.0; }
    // Displacements of a contact port now and free of forces, and per psi_m.
    virtual ContactSums contact(int, int) const { return {0, 0, 0}; }

protected:
    using S = Simd;
    using V = S::V;

    double* row(int s) const { return block_.job.potentials + t_.two_way[s].at; }

    // Scales the velocities of modes: use(component, n modes) of each part; returns the part of the cost that was paid.
    template <class Each>
    double pay_from_motion(const Each& each, double cost) {
        const auto velocities = [&](const auto& use) {
            each([&](int i, std::size_t count) {
                const double *const per = components_[i].coordinates.velocity.data(), *const x = block_.x(i);
                double* const y = block_.y(i);
                const std::size_t n = components_[i].n;
                for (std::size_t k = 0; k < count; ++k) use(per[k] * x[k] + per[n + k] * y[k], per[2 * n + k], y[k]);
            });
        };
        double kinetic = 0.0;
        velocities([&](double v, double, double&) { kinetic += 0.5 * v * v; });
        const double paid = std::clamp(cost, -kPaidAtOnce * kinetic, kPaidAtOnce * kinetic);
        if (!(kinetic > 0.0 && paid != 0.0)) return 0.0;
        const double factor = std::sqrt(1 - paid / kinetic) - 1;
        velocities([&](double v, double per, double& second) { second += factor * per * v; });
        return paid;
    }

    PotentialRun& run_;
    Block& block_;
    const std::vector<Component>& components_;
    const Potentials& t_;
    PotentialState& ws_;
    const int first_, end_;
};

// Makes the groups of a run, kind by kind (kinds.hpp).
inline std::vector<std::unique_ptr<PotentialGroup>> make_potential_groups(PotentialRun& run);

class PotentialSolve {
public:
    // `parts`: of the linear connections, where they are solved in parts.
    PotentialSolve(Block& block, ForcesInParts& parts)
        : run_(block), block_(block), components_(block.model.components), layout_(block.model.layout), t_(run_.t),
          ws_(run_.ws), parts_(parts.on() ? &parts : nullptr), groups_(make_potential_groups(run_)) {
        for (const auto& group : groups_) group->begin();
    }

    int count() const { return int(t_.two_way.size()); }
    bool in_parts() const { return parts_; }
    int potential_of(int component) const { return part(component).part->potential; }
    double excursion(int component) const { return part(component).group->excursion(component); }
    ContactSums contact(int component, int port) const { return part(component).group->contact(component, port); }

    void begin_block() {
        if (!from_state_) return;
        for (const PotentialPart& part : run_.parts) run_.scaled.from_state(part.part->component);
        from_state_ = false;
    }

    // Forms the sums that sample b needs of all components, and writes the displacements of their ports now and free of
    // forces.
    void begin_sample(int b) {
        sample_ = b;
        for (const auto& group : groups_) group->begin_step();
        for (PotentialPart& part : run_.parts) begin(part);
        for (std::size_t k = 0; k < t_.n_sums; k += Simd::width)
            Simd::store(ws_.sums.data() + k, sums<Simd::width>(ws_.lanes.data() + k * Simd::width));
        for (const PotentialPart& part : run_.parts) {
            const double* sum = ws_.sums.data() + part.part->sums + kSharedSums;
            const Potentials::Port* port = t_.ports.data() + part.part->first_port;
            for (int p = 0; p < part.c->n_ports; ++p, sum += kPortSums, ++port)
                block_.line(b)[port->line] = sum[0], block_.line(b + 1)[port->line] = sum[1];
        }
    }

    // Finds the directions, M and psi_m without nonlinear connections from the port forces (force_width) of the linear
    // connections without potentials.
    void couple(const double* alone) { couple(alone, alone, t_.onto_ports.data()); }

    // As above, where linear laws answer too: `answering` are the port forces with them, and (ports, width) those
    // forces per displacement of the ports. The directions are those of the linear connections `alone`.
    void couple(const double* alone, const double* answering, const double* onto_ports) {
        const int n = int(t_.ports.size());
        for (int p = 0; p < n; ++p)
            ws_.driven[p] = alone[t_.ports[p].force], ws_.answering[p] = answering[t_.ports[p].force];
        std::fill(ws_.pulled.begin(), ws_.pulled.end(), 0.0);
        bool pulled = false;
        for (const auto& group : groups_) pulled = group->pull() || pulled;
        if (pulled) {  // the connections answer to the fast coordinates
            const int width = t_.most * t_.lanes;
            double* const answer = ws_.reach_lanes.data();
            std::fill_n(answer, width, 0.0);
            add_product(t_.onto_ports.data(), width, ws_.pulled.data(), n, answer);
            for (int p = 0; p < n; ++p) ws_.answered[p] = ws_.driven[p] + answer[t_.ports[p].lane];
        }
        for (const auto& group : groups_) group->direct();
        make_matrix(onto_ports);
        factorized_ = false;
        if (count() < kLane) {
            solve_few(ws_.matrix.data(), ws_.unit.data(), count(), ws_.alone.data());
        } else if (!solve_near_diagonal(ws_.matrix.data(), count(), ws_.over.data(), ws_.upper.data(),
                                        ws_.alone.data())) {
            factorized_ = true;
            factorize(ws_.matrix.data(), count(), ws_.upper.data(), ws_.over.data());
            solve_definite(ws_.matrix.data(), ws_.upper.data(), ws_.over.data(), count(), ws_.alone.data());
        }
        std::copy(ws_.alone.begin(), ws_.alone.end(), ws_.mean.begin());
    }

    // M^-1 b in place for the columns of b (potentials, width), width a multiple of kLane.
    void solve(double* b, std::size_t width) {
        if (!factorized_) factorize(ws_.matrix.data(), count(), ws_.upper.data(), ws_.over.data());
        factorized_ = true;
        solve_columns(ws_.matrix.data(), ws_.over.data(), count(), b, width);
    }

    // Adds the answer of the linear connections to psi_m: port forces `now` (not in parts), or the connections' own
    // forces f.
    void add_to_ports(double* now) {
        find_moved();
        add_product(t_.onto_forces.data(), layout_.force_width, ws_.moved.data(), t_.answered, now);
    }
    void add_to_linear(double* f) {
        if (!parts_) {
            find_moved();
            return add_product(t_.onto_linear.data(), layout_.f_width, ws_.moved.data(), t_.answered, f);
        }
        for (std::size_t p = 0; p < t_.ports.size(); ++p) ws_.y[t_.ports[p].place] = moved(p);
        parts_->subtract_answer(ws_.y.data(), f);
    }

    // Adds the product of a matrix (ports, width) and the displacements -psi_m C of the ports.
    void add(const double* matrix, int width, double* to) {
        find_moved();
        add_product(matrix, width, ws_.moved.data(), int(t_.ports.size()), to);
    }

    // The means and all port forces of the sample are final; loads(component): forces on its contact ports.
    template <class Loads>
    void finish_sample(const double* now, const Loads& loads) {
        for (const auto& group : groups_) group->end_step();
        for (std::size_t p = 0; p < t_.ports.size(); ++p) ws_.forces[p] = now[t_.ports[p].force];
        for (PotentialPart& part : run_.parts) {
            part.pending = true;
            const auto& inputs = block_.inputs[part.part->component];
            const auto loaded = loads(part.part->component);
            if (inputs.empty() && loaded.empty()) continue;
            finish(part);
            const double* const basis = part.c->coordinates.basis.data();
            const std::size_t n = part.c->n;
            for (const auto& [port, force] : loaded) {
                const double* row = part.c->contact.rows.data() + 2 * std::size_t(port) * n;
                each_vector(part, [&](std::size_t k, V& xi, V& v, const double* at) {
                    const V modal = S::load(basis + 3 * n + k) * S::load(row + k) * force;
                    xi += modal, v += (S::load(at + 4 * kPadding) - S::load(at + 3 * kPadding)) * modal;
                });
            }
            for (const Input& in : inputs) {
                const double value = in.values[sample_];
                each_vector(part, [&](std::size_t k, V&, V& v, const double*) {
                    v += (S::load(basis + 6 * n + k) * S::load(in.vector + k) +
                          S::load(basis + 7 * n + k) * S::load(in.vector + n + k)) * value;
                });
            }
        }
    }

    // Writes the potentials' numbers to the state and, where the next block or a readout needs them, the modes; puts
    // psi back at multiples of kResetSteps samples.
    void finish_block() {
        const std::int64_t end = block_.start + block_.nb;
        const bool resets = (block_.job.phase + end) % kResetSteps == 0, last = resets || end == block_.job.n;
        for (PotentialPart& part : run_.parts) {
            if (!last && !part.is_read && !part.is_grouped) continue;
            finish(part);
            run_.scaled.to_state(part.part->component);
            rows(part, 0, block_.nb);
        }
        if (!last) return;
        for (const auto& group : groups_) group->keep(resets);
        from_state_ = resets;
    }

private:
    using S = Simd;
    using V = S::V;

    // M in ws.matrix.
    void make_matrix(const double* onto_ports) {
        const int all = count(), lanes = t_.lanes, width = t_.most * lanes;
        std::fill(ws_.reach_lanes.begin(), ws_.reach_lanes.end(), 0.0);
        for (std::size_t p = 0; p < t_.ports.size(); ++p) ws_.reach_lanes[t_.ports[p].lane] = ws_.reach[p];
        const auto columns = [&]<int B>(int s, int q) {  // B vectors of row s from the q-th number on
            const Potentials::One& one = t_.two_way[s];
            V sum[B] = {};
            for (int m = 0; m < t_.most; ++m) {
                V stiff[B] = {};
                for (int p = one.first; p < one.first + one.n; ++p) {
                    const double* const row = onto_ports + std::size_t(p) * width + m * lanes + q;
                    for (int i = 0; i < B; ++i) stiff[i] += S::load(row + i * S::width) * ws_.reach[p];
                }
                const double* const reach = ws_.reach_lanes.data() + m * lanes + q;
                for (int i = 0; i < B; ++i) sum[i] += stiff[i] * S::load(reach + i * S::width);
            }
            const double* const unit = ws_.unit.data() + lanes - s + q;
            const double diagonal = 1.0 + 0.5 * ws_.own[s];
            double* const row = ws_.matrix.data() + s * lanes + q;
            for (int i = 0; i < B; ++i)
                S::store(row + i * S::width, sum[i] * 0.5 + S::load(unit + i * S::width) * diagonal);
        };
        for (int s = 0; s < all; ++s) {
            int q = 0;
            for (; q + kPack * S::width <= lanes; q += kPack * S::width) columns.template operator()<kPack>(s, q);
            for (; q < all; q += S::width) columns.template operator()<1>(s, q);
        }
    }

    const PotentialPart& part(int component) const { return run_.parts[run_.part_of[component]]; }
    void find_moved() {
        for (std::size_t p = 0; p < t_.ports.size(); ++p) ws_.moved[p] = moved(p);
    }
    double moved(std::size_t p) const { return -ws_.mean[t_.ports[p].potential] * ws_.reach[p]; }

    // use(first mode, xi, v, numbers) of a vector of modes at a time, which may change xi and v.
    template <class Use>
    static void each_vector(const PotentialPart& part, const Use& use) {
        const std::size_t n = part.c->n, step = std::size_t(kScaledNumbers + part.c->n_ports) * kPadding;
        for (std::size_t k = 0; k < n; k += S::width) {
            const std::size_t group = k / kPadding, j = k % kPadding;
            double* const at = part.state + group * kScaledState * kPadding + j;
            S::V xi = S::load(at), v = S::load(at + kPadding);
            use(k, xi, v, part.c->coordinates.numbers.data() + group * step + j);
            S::store(at, xi), S::store(at + kPadding, v);
        }
    }

    void begin(PotentialPart& part) {
        const int i = part.part->component;
        double* const to = ws_.lanes.data() + part.part->sums * Simd::width;
        const bool summed = part.pending && block_.inputs[i].empty() && part.group->advance(part, to);
        if (summed) made(part);
        else finish(part);
        if (part.is_read) run_.scaled.to_state(i), rows(part, part.c->n_ports, sample_);
        if (summed) return;
        const double *const basis = part.c->coordinates.basis.data(), *const middle = part.c->coordinates.middle.data();
        double* const known = ws_.known.data() + part.c->offset;
        part.known = block_.inputs[i].empty() ? nullptr : known;
        if (part.known) std::fill_n(known, part.c->n, 0.0);
        for (const Input& in : block_.inputs[i]) {
            const double value = in.values[sample_];
            each_vector(part, [&](std::size_t k, V&, V& v, const double*) {
                const V added = S::load(basis + k) * S::load(in.vector + k) * value;
                v += added;
                S::store(known + k, S::load(known + k) +
                                        (S::load(middle + part.c->n + k) - S::load(middle + k)) * 2.0 * added);
            });
        }
        part.group->sum(part, to);
    }

    // Makes the step that is still pending.
    void finish(PotentialPart& part) {
        if (!part.pending) return;
        part.group->make(part);
        made(part);
    }

    void made(PotentialPart& part) {
        run_.scaled.invalidate(part.part->component);
        part.pending = false;
    }

    // Rows of a component from the first-th on.
    void rows(const PotentialPart& part, int first, int b) {
        const Component& c = *part.c;
        const int i = part.part->component;
        double* line = block_.line(b) + layout_.row[i];
        for (int r = first; r < c.n_rows; ++r) {
            const double* row = c.rows.data() + 2 * std::size_t(r) * c.n;
            line[r] = dot(row, block_.x(i), c.n) + dot(row + c.n, block_.y(i), c.n);
        }
    }

    PotentialRun run_;
    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Potentials& t_;
    PotentialState& ws_;
    ForcesInParts* const parts_;
    std::vector<std::unique_ptr<PotentialGroup>> groups_;
    bool from_state_ = true, factorized_ = false;  // the latter: ws.matrix holds the factors of M
    int sample_ = 0;
};

}  // namespace
}  // namespace tonewood
