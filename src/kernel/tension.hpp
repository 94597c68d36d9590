// Strings whose tension rises with amplitude, sample by sample; the equations are in tonewood.numerics.tension.
//
// What other components and connections do is linear in the displacements d_p that a stretched component's ports would
// come to by themselves, less what their compliance at rest gives for their forces:
//     d = sum r (U - x) + (Z(T) - Z(0)) f,      all port forces = fixed part + onto^T d.
// So the forces are a fixed point that shrinks by the relative rise of the tension in each turn; T obeys
// T = kappa (S+ + S). A visit to the modes (tense_ports.hpp) tells both near the tension foreseen: as a rule one visit
// makes the step before and settles this one.
#pragma once

#include <algorithm>
#include <cmath>

#include "lines.hpp"
#include "nonlinear.hpp"
#include "tense_ports.hpp"

namespace tonewood {
namespace {

template <class T>
constexpr double kTensionTolerance = sizeof(T) == sizeof(double) ? 1e-11 : 1e-5;  // of the tension
template <class T>
constexpr double kForceTolerance = sizeof(T) == sizeof(double) ? 1e-14 : 1e-7;  // of the largest force
template <class T>
constexpr double kSettled = sizeof(T) == sizeof(double) ? 1e-15 : 1e-8;  // of a mode's stiffness, between two turns
constexpr int kMaxTensionIterations = 200, kMaxTurns = 100;
// relative change of a mode's stiffness up to which port displacements may be told by three terms, its cube being lost
template <class T>
constexpr double kTold = sizeof(T) == sizeof(double) ? 3e-5 : 5e-3;
constexpr double kFar = 0.1;      // and up to which one visit may go on
constexpr double kCell = 0.01;    // the same over a cell of compliances
constexpr double kStrong = 0.05;  // beyond it forces are found by an inverse

template <class T>
class TensionStep {
    friend class TenseContacts<T>;

public:
    TensionStep(const std::vector<Component<T>>& components, const Layout& layout, const Solve& solve,
                const Tensions& tensions, TensionSpace& space, Statistics& statistics, const Job<T>& job,
                const std::vector<std::vector<Input<T>>>& known)
        : components_(components), layout_(layout), solve_(solve), tensions_(tensions), ws_(space), ports_(space.ports),
          statistics_(statistics), job_(job), known_(known), at_once_(layout), pushed_(components.size()), forces_(space.ports.ports.size()) {
        for (const int i : tensions_.components) pushed_[i].reserve(components[i].guarded.n), ws_.pending[i] = 0;
    }

    // Sample b of a block: rows of the stretched components, tensions, forces of the linear connections in f, port
    // forces in now. The stretched components move by the next sample, or the end of the block. False if the tensions
    // were not found.
    bool step(int b, double* lines, double* f, double* now) {
        begin_sample(b, lines);
        if (!linear_step(f, now)) return false;
        finish_sample(now);
        return true;
    }

    // The last step and the rows of the stretched components at the end of a block.
    void finish_block(int nb, double* lines) {
        for (const int i : tensions_.components) {
            make(i);
            rows(i, 0, nb, lines);
        }
    }

private:
    using V = typename Simd<T>::V;
    using S = Simd<double>;
    static constexpr int kWidth = Simd<T>::width;

    T* x(int i) const { return job_.modes[0] + components_[i].offset; }
    T* y(int i) const { return job_.modes[1] + components_[i].offset; }
    T* kept(int i) const { return buffer(ws_.yields, i); }
    T* lanes(std::size_t sum) const { return reinterpret_cast<T*>(ports_.lanes.data()) + sum * kWidth; }
    T* forces_on(int i) { return forces_.data() + ports_.first[i]; }
    int n_strings() const { return int(tensions_.strings.size()); }

    // The stretched components come to sample b; what they are there, and what pulls at them from outside.
    void begin_sample(int b, double* lines) {
        sample_ = b;
        if (b == 0) {  // a block depends on nothing but the state it begins with
            ws_.inverted = false;
            for (const int i : tensions_.components) ws_.kept_at[i] = INFINITY;
            for (Array<double>* a : {&ports_.force, &ports_.base}) std::fill(a->begin(), a->end(), 0.0);
        }
        // S, or the means of T at a block's beginning, going on as a parabola
        for (int s = 0; s < n_strings(); ++s) {
            const double *t = job_.tension + 3 * tensions_.strings[s].index, kappa = tensions_.strings[s].kappa;
            double foreseen = 3 * (t[0] - t[1]) + t[2];
            if (b > 0 && kappa > 0.0) {
                const double stretch = t[0] / kappa - ws_.stretch[s];
                foreseen = kappa * (stretch + 3 * (stretch - ws_.stretch[s]) + ws_.past[s]);
                ws_.past[s] = ws_.stretch[s];
            }
            ws_.at[s] = std::max(foreseen, 0.0);
            look(s);
        }
        fold();
        for (int s = 0; s < n_strings(); ++s) {
            const auto& string = tensions_.strings[s];
            if (b == 0 && string.kappa > 0.0)
                ws_.past[s] = job_.tension[3 * string.index] / string.kappa - ws_.stretch[s];
        }
        double* line = lines + std::size_t(b) * layout_.width;
        for (std::size_t p = 0; p < ports_.ports.size(); ++p) line[ports_.ports[p].line] = ports_.of_port[0][p];
        for (const int i : tensions_.components) rows(i, components_[i].n_ports, b, lines);
        for (const auto& port : ports_.ports) line[layout_.width + port.line] = 0.0;
        at_once_(line, ports_.fixed_part.data());
        for (std::size_t p = 0; p < ports_.ports.size(); ++p) ports_.fixed[p] = ports_.fixed_part[ports_.ports[p].force];
        line_ = line;
        linear_known_ = false;
    }

    // Forces of the linear connections while the ports do not move by themselves.
    const double* linear_part() {
        if (linear_known_) return ports_.linear.data();
        const int n = int(layout_.port_rows.size());
        for (int p = 0; p < n; ++p) {
            ports_.y[p] = line_[layout_.port_rows[p]];
            ports_.y[n + p] = line_[layout_.width + layout_.port_rows[p]];
        }
        std::copy(layout_.constant.begin(), layout_.constant.end(), ports_.linear.begin());
        add_product(layout_.pull.data(), layout_.f_width, ports_.y.data(), 2 * n, ports_.linear.data());
        linear_known_ = true;
        return ports_.linear.data();
    }

    // Visits a string's modes at the tension ws.at, which may make the step that is due.
    void look(int s) {
        T* const all = lanes(ports_.shared[s]);
        std::fill_n(all, kSharedSums * kWidth, T(0));
        for (const int i : tensions_.strings[s].components) {
            const Component<T>& c = components_[i];
            const double at = ws_.at[s], half = c.stretched.most_half;
            T* const own = lanes(ports_.own[i]);
            Visit<T> v;
            v.tried = at, v.begun = sample_;
            v.inputs = known_[i].data(), v.n_inputs = int(known_[i].size());
            if (ws_.pending[i] && std::abs(ws_.used[s] - ws_.kept_at[i]) * half < kNear<T> &&
                std::abs(at - ws_.used[s]) * half < kNear<T>) {
                v.made = ws_.used[s], v.forces = forces_on(i);
                visit<T, true, true, true>(c, x(i), y(i), kept(i), v, all, own);
                ws_.pending[i] = 0;
            } else {
                make(i);
                bring_near(i, at);
                if (v.n_inputs)
                    visit<T, false, true, false>(c, x(i), y(i), kept(i), v, all, own);
                else
                    visit<T, false, true, true>(c, x(i), y(i), kept(i), v, all, own);
            }
            ws_.kept_at[i] = at;
        }
    }

    // Makes the step that is due.
    void make(int i) {
        if (!ws_.pending[i]) return;
        Visit<T> v;
        v.made = ws_.used[ports_.string_of[i]], v.forces = forces_on(i);
        bring_near(i, v.made);
        visit<T, true, false, true>(components_[i], x(i), y(i), kept(i), v, nullptr, nullptr);
        ws_.kept_at[i] = v.made;
        ws_.pending[i] = 0;
    }

    // What is kept of a component's modes must be near the next tension.
    void bring_near(int i, double tension) {
        const Component<T>& c = components_[i];
        if (!(std::abs(tension - ws_.kept_at[i]) * c.stretched.most_half < kNear<T>)) keep(i, tension);
    }

    // 1 / (1 + a T g / 2) of a component's modes, divided.
    void keep(int i, double tension) {
        if (ws_.kept_at[i] == tension) return;
        const Component<T>& c = components_[i];
        const T *const a = c.stretched.weight.data(), *const gain = c.stretched.gain.data(), half = T(0.5 * tension);
        T* const to = kept(i);
        for (int k = 0; k < c.n; k += kWidth)
            Simd<T>::store(to + k, T(1) / (T(1) + Simd<T>::load(gain + k) * (Simd<T>::load(a + k) * half)));
        ws_.kept_at[i] = tension;
    }

    // Sums of a visit, those of ports side by side.
    void fold() {
        double* to = ports_.sums.data();
        const std::size_t n = ports_.sums.size();
        for (std::size_t k = 0; k < n; k += kWidth) {
            const V sum = sums<T, kWidth>(lanes(k));
            for (int i = 0; i < kWidth; ++i) to[k + i] = double(sum[i]);
        }
        for (std::size_t p = 0; p < ports_.ports.size(); ++p) {
            const auto& port = ports_.ports[p];
            const double* from = to + ports_.own[port.component] + std::size_t(port.port) * kPortSums;
            for (int i = 0; i < kPortSums; ++i) ports_.of_port[i][p] = from[i];
        }
        for (int s = 0; s < n_strings(); ++s) ws_.stretch[s] = to[ports_.shared[s]];
    }

    // Tensions and forces where only linear connections act.
    bool linear_step(double* f, double* now) {
        const bool done = find(kForceTolerance<T>, true, [&](double* force) {
            std::copy(ports_.base.begin(), ports_.base.end(), force);
            add_product(onto_, ports_.width, ports_.moved.data(), int(ports_.ports.size()), force);
            return true;
        });
        statistics_.failures += !done;
        add_moved();
        std::copy(ports_.fixed_part.begin(), ports_.fixed_part.end(), now);
        add_product(ports_.onto_forces.data(), layout_.force_width, ports_.alone.data(), int(ports_.ports.size()), now);
        if (layout_.own_port.empty()) {
            linear_forces(f);
        } else {
            for (int j = 0; j < solve_.m; ++j) f[j] = layout_.own_factor[j] * now[layout_.own_port[j]];
        }
        return done;
    }

    // ports.alone becomes all of what ports move by.
    void add_moved() {
        for (std::size_t p = 0; p < ports_.ports.size(); ++p) ports_.alone[p] += ports_.moved[p];
    }

    // Forces of the linear connections, after that.
    void linear_forces(double* f) {
        std::copy_n(linear_part(), layout_.f_width, f);
        add_product(ports_.onto_linear.data(), layout_.f_width, ports_.alone.data(), int(ports_.ports.size()), f);
    }

    // Tensions, and the forces on the ports: `answer` tells these from the displacements ports.moved. `plain`: it adds
    // them to ports.base and nothing else, so that this is close.
    template <class Answer>
    bool find(double tolerance, bool plain, const Answer& answer) {
        int iterations = 0;
        bool done = false;
        while (!done && iterations++ < kMaxTensionIterations) {
            if (iterations == 1) {
                std::copy(ws_.at.begin(), ws_.at.end(), ws_.tension.begin());
                std::fill(ws_.last_tension.begin(), ws_.last_tension.end(), NAN);
            } else {
                for (int s = 0; s < n_strings(); ++s)
                    if (!close_enough(s)) ws_.at[s] = ws_.tension[s], look(s);
                fold();
            }
            bool told = false;
            for (int turn = 0; !told && turn < kMaxTurns; ++turn) {
                if (!displacements(plain)) return book(iterations, false);
                if (strong_ && !plain) return book(iterations, false);
                bool settled = false;
                if (!settle(turn == 0 ? 3 : kMaxTurns, tolerance, answer, settled)) return book(iterations, false);
                told = !raise_tensions() && settled;
            }
            done = told;
            for (int s = 0; s < n_strings(); ++s) done = done && close_enough(s);
        }
        for (int s = 0; s < n_strings(); ++s) ws_.used[s] = ws_.tension[s];
        return book(iterations, done);
    }

    bool book(int iterations, bool done) {
        statistics_.tension_iterations += iterations;
        statistics_.most_tension_iterations = std::max<std::int64_t>(statistics_.most_tension_iterations, iterations);
        return done;
    }

    // Where the ports come to by themselves at the tensions tried, and how their compliances differ from those at rest.
    bool displacements(bool plain) {
        const int n = int(ports_.ports.size()), width = ports_.pair_width;
        largest_ = 0.0;
        for (int s = 0; s < n_strings(); ++s) {
            if (!std::isfinite(ws_.tension[s])) return false;
            enter_cell(s);
            largest_ = std::max(largest_, ws_.tension[s] * ports_.cells[s].most);
        }
        strong_ = largest_ > kStrong;
        double *const by = ports_.by.data(), *const to = ports_.alone.data();
        double *const off = ports_.off.data(), *const change = ports_.change.data(), *const slope = ports_.slope.data();
        for (int s = 0; s < n_strings(); ++s) {
            const auto& [first, last, first_pair, last_pair] = ports_.ranges[s];
            for (int p = first; p < last; ++p) by[p] = ws_.tension[s] - ws_.at[s];
            for (int q = first_pair; q < last_pair; ++q) off[q] = ws_.tension[s] - ports_.cells[s].low;
        }
        for (int p = 0; p < ports_.width; p += S::width) {
            const S::V half = of(ports_.by, p) * 0.5;
            S::store(to + p, of_port(1, p) - of_port(0, p) - half * (of_port(3, p) - half * of_port(5, p)));
        }
        for (int q = 0; q < width; q += S::width) {
            const S::V by = S::load(off + q);
            S::V value{}, rise{};
            for (int j = kTaylor - 1; j >= 0; --j) {
                rise = rise * by + value;
                value = value * by + S::load(&ports_.changes[std::size_t(j) * width + q]);
            }
            S::store(change + q, value), S::store(slope + q, rise);
        }
        if (!ports_.single)
            for (std::size_t q = 0; q < ports_.pairs.size(); ++q) {
                const auto& pair = ports_.pairs[q];
                ports_.changed[std::size_t(pair.to) * ports_.width + pair.from] = change[q];
                ports_.changed[std::size_t(pair.from) * ports_.width + pair.to] = change[q];
            }
        double *const base = ports_.base.data(), *const force = ports_.force.data();
        if (plain)
            for (int p = 0; p < ports_.width; p += S::width) S::store(force + p, S::load(force + p) - S::load(base + p));
        add_product(onto_, ports_.width, to, n, fixed_, base);
        if (plain)
            for (int p = 0; p < ports_.width; p += S::width) S::store(force + p, S::load(force + p) + S::load(base + p));
        if (strong_) invert_ports();
        return true;
    }

    // Compliances about the tension of a string, made anew where it leaves their cell.
    void enter_cell(int s) {
        auto& cell = ports_.cells[s];
        const double tension = ws_.tension[s];
        if (cell.index >= 0 && tension >= cell.low && tension < cell.high) return;
        const auto begin = [&](int index) { return std::expm1(kCell * index) / cell.most; };
        int index = int(std::log1p(cell.most * tension) / kCell);
        while (index > 0 && tension < begin(index)) --index;
        while (tension >= begin(index + 1)) ++index;
        cell.index = index, cell.low = begin(index), cell.high = begin(index + 1);
        for (std::size_t q = 0; q < ports_.pairs.size(); ++q) {
            const auto& pair = ports_.pairs[q];
            if (pair.string != s) continue;
            double terms[kTaylor];
            compliances(components_[pair.component], cell.low, ports_.ports[pair.to].port, ports_.ports[pair.from].port,
                        terms);
            for (int j = 0; j < kTaylor; ++j) ports_.changes[std::size_t(j) * ports_.pair_width + q] = terms[j];
        }
    }

    // ports.moved = (Z(T) - Z(0)) f
    void move_ports(const double* force) {
        const int n = int(ports_.ports.size());
        double* const to = ports_.moved.data();
        if (ports_.single) {
            for (int p = 0; p < ports_.width; p += S::width) S::store(to + p, of(ports_.change, p) * S::load(force + p));
            return;
        }
        std::fill_n(to, ports_.width, 0.0);
        add_product(ports_.changed.data(), ports_.width, force, n, to);
    }

    // The forces that the displacements call up and that make the displacements, at the tensions tried. Each turn shrinks
    // what is wrong by about the largest rise of a mode's stiffness; `settled` once that is below `tolerance`.
    template <class Answer>
    bool settle(int turns, double tolerance, const Answer& answer, bool& settled) {
        const int n = int(ports_.ports.size());
        double *const force = ports_.force.data(), *const next = ports_.next.data();
        const double shrinks = strong_ ? 1.0 : std::min(1.0, 2 * largest_);
        for (int turn = 0; turn < turns; ++turn) {
            move_ports(force);
            if (!answer(next)) return false;
            S::V changes{}, sizes{}, check{};
            for (int p = 0; p < ports_.width; p += S::width) {
                const S::V now = S::load(next + p), wrong = now - S::load(force + p);
                const S::V change = wrong < 0.0 ? -wrong : wrong, size = now < 0.0 ? -now : now;
                changes = change > changes ? change : changes, sizes = size > sizes ? size : sizes;
                check += change;
                S::store(&ports_.wrong[p], wrong);
            }
            if (!(S::sum(check) <= 1e300)) return false;
            double change = 0.0, size = 0.0;
            for (int p = 0; p < S::width; ++p) change = std::max(change, changes[p]), size = std::max(size, sizes[p]);
            if (strong_) {
                for (int p = 0; p < n; ++p)
                    for (int q = 0; q < n; ++q) force[p] += ports_.inverse[std::size_t(p) * n + q] * ports_.wrong[q];
            } else {
                std::copy_n(next, n, force);
            }
            settled = change * shrinks <= tolerance * size;
            if (settled) break;
        }
        move_ports(force);
        return true;
    }

    // ports.inverse = (I - onto^T (Z(T) - Z(0)))^-1 by Gauss and Jordan: its diagonal dominates as that of 1 + a T w / 2.
    void invert_ports() {
        const int n = int(ports_.ports.size());
        double *const a = ports_.inverse.data(), *const unit = ports_.wrong.data();
        for (int p = 0; p < n; ++p) {
            for (int q = 0; q < n; ++q) unit[q] = q == p ? 1.0 : 0.0;
            move_ports(unit);
            for (int to = 0; to < n; ++to) {
                double sum = to == p ? 1.0 : 0.0;
                for (int q = 0; q < n; ++q)
                    sum -= onto_[std::size_t(q) * ports_.width + to] * ports_.moved[q];
                a[std::size_t(to) * n + p] = sum;
            }
        }
        int* const pivots = ports_.pivots.data();
        for (int p = 0; p < n; ++p) {
            int best = p;
            for (int i = p + 1; i < n; ++i)
                if (std::abs(a[i * n + p]) > std::abs(a[best * n + p])) best = i;
            pivots[p] = best;
            for (int j = 0; j < n; ++j) std::swap(a[p * n + j], a[best * n + j]);
            const double pivot = a[p * n + p];
            a[p * n + p] = 1.0;
            for (int j = 0; j < n; ++j) a[p * n + j] /= pivot;
            for (int i = 0; i < n; ++i) {
                if (i == p) continue;
                const double ratio = a[i * n + p];
                a[i * n + p] = 0.0;
                for (int j = 0; j < n; ++j) a[i * n + j] -= ratio * a[p * n + j];
            }
        }
        for (int p = n - 1; p >= 0; --p)
            for (int i = 0; i < n; ++i) std::swap(a[i * n + p], a[i * n + pivots[p]]);
    }

    static S::V of(const Array<double>& a, int p) { return S::load(&a[p]); }
    S::V of_port(int sum, int p) const { return S::load(&ports_.of_port[sum][p]); }

    // Newton's step of every tension, at the forces found; true if one of them changed.
    bool raise_tensions() {
        bool changed = false;
        double *const gained = ports_.gained.data(), *const steep = ports_.steep.data();
        double *const pushed = ports_.pushed.data(), *const sharp = ports_.sharp.data();
        for (int p = 0; p < ports_.width; p += S::width) {
            const S::V f = of(ports_.force, p), rises = 2.0 * of_port(5, p) - of_port(4, p);
            S::store(gained + p, f * (2.0 * (of_port(3, p) - of_port(2, p)) - of(ports_.by, p) * rises));
            S::store(steep + p, f * rises);
        }
        if (ports_.single) {
            for (int p = 0; p < ports_.width; p += S::width) both_pushed(p, of(ports_.force, p) * of(ports_.force, p));
        } else {
            for (std::size_t q = 0; q < ports_.pairs.size(); ++q) {
                const auto& pair = ports_.pairs[q];
                ports_.both[q] = ports_.force[pair.to] * ports_.force[pair.from] * (pair.to == pair.from ? 1.0 : 2.0);
            }
            for (int q = 0; q < ports_.pair_width; q += S::width) both_pushed(q, of(ports_.both, q));
        }
        for (int s = 0; s < n_strings(); ++s) {
            const double *all = &ports_.sums[ports_.shared[s]], by = ws_.tension[s] - ws_.at[s];
            const auto& [first, last, first_pair, last_pair] = ports_.ranges[s];
            double after = all[1] - by * all[2], steepness = all[2], push = 0.0, sharpness = 0.0;
            for (int p = first; p < last; ++p) after += gained[p], steepness += steep[p];
            for (int q = first_pair; q < last_pair; ++q) push += pushed[q], sharpness += sharp[q];
            ws_.after[s] = after, ws_.steepness[s] = steepness, ws_.pushed[s] = push, ws_.sharp[s] = sharpness;
        }
        for (int s = 0; s < n_strings(); ++s) {
            const double kappa = tensions_.strings[s].kappa, old = ws_.stretch[s];
            const double excess = ws_.tension[s] - kappa * (old + ws_.after[s] + ws_.pushed[s]);
            const double reach = kFar * (ws_.at[s] + 1 / ports_.cells[s].most);
            const double steepness = std::max(1 + kappa * ws_.steepness[s], 0.5);
            const double secant = (excess - ws_.last_excess[s]) / (ws_.tension[s] - ws_.last_tension[s]);
            ws_.last_excess[s] = excess, ws_.last_tension[s] = ws_.tension[s];
            const auto within = [&](double next) {
                return std::max(std::clamp(next, ws_.at[s] - reach, ws_.at[s] + reach), kappa * old);
            };
            double next = within(ws_.tension[s] - excess / steepness);
            const double still = kSettled<T> * std::max(1 / ports_.cells[s].most, 20 * next);
            if (std::abs(next - ws_.tension[s]) <= std::max(still, 0.2 * kTensionTolerance<T> * next)) continue;
            // that was at constant forces; a secant knows how they answer, and goes less far where it is steeper
            if (secant > steepness) next = within(ws_.tension[s] - excess / secant);
            ws_.tension[s] = next;
            changed = true;
        }
        return changed;
    }

    // What pairs of forces give to the stretch: -2 f f' dZ/dT, and how it bends.
    void both_pushed(int q, S::V both) {
        const S::V bend = both * S::load(&ports_.changes[3 * std::size_t(ports_.pair_width) + q]);
        S::store(&ports_.pushed[q], -2.0 * both * of(ports_.slope, q));
        S::store(&ports_.sharp[q], bend < 0.0 ? -bend : bend);
    }

    // Whether the sums of the visit tell the motion of a string at the tension found: what their polynomials leave out
    // is bounded by Cauchy's inequality.
    bool close_enough(int s) const {
        const double kappa = tensions_.strings[s].kappa, by = std::abs(ws_.tension[s] - ws_.at[s]);
        const double most = ports_.cells[s].most, near = by * most / (1 + most * std::min(ws_.tension[s], ws_.at[s]));
        const double own = ports_.sums[ports_.shared[s] + 3];
        const double lost = by * by * (own + 6 * std::sqrt(own * ws_.sharp[s]));
        const double size = ws_.stretch[s] + ws_.after[s] + std::abs(ws_.pushed[s]);
        return near <= kTold<T> &&
               kappa * lost <= 0.5 * kTensionTolerance<T> * (ws_.tension[s] + 1e-2 * kappa * size);
    }

    // Newton's step of every tension; true if they were right already. `gain_of` adds what a component's stretch gains.
    template <class Gain>
    bool correct(int iteration, const Gain& gain_of) {
        bool found = true;
        for (int s = 0; s < n_strings(); ++s) {
            const auto& string = tensions_.strings[s];
            double after = ws_.stretch[s], slope = 0.0, size = after;
            for (const int i : string.components) gain_of(i, after, slope, size);
            const double excess = ws_.tension[s] - string.kappa * (after + ws_.stretch[s]);
            ws_.used[s] = ws_.tension[s];
            if (!(std::abs(excess) <= kTensionTolerance<T> * (ws_.tension[s] + 1e-2 * string.kappa * size))) found = false;
            // the slope at constant forces first, then the secant, which knows how the forces answer
            double steepness = 1 - string.kappa * slope;
            if (iteration > 1) {
                const double secant = (excess - ws_.last_excess[s]) / (ws_.tension[s] - ws_.last_tension[s]);
                if (secant > 0.5 * steepness && secant < 2 * steepness) steepness = secant;
            }
            ws_.last_excess[s] = excess, ws_.last_tension[s] = ws_.tension[s];
            ws_.tension[s] = std::max(string.kappa * ws_.stretch[s], ws_.tension[s] - excess / steepness);
        }
        return found;
    }

    // The step is found, the port forces known. It is made at once where more than fixed ports and springs push.
    void finish_sample(const double* now) {
        for (int s = 0; s < n_strings(); ++s) {
            double* t = job_.tension + 3 * tensions_.strings[s].index;
            t[2] = t[1], t[1] = t[0], t[0] = ws_.used[s];
            for (const int i : tensions_.strings[s].components) {
                for (int p = 0; p < components_[i].n_ports; ++p) forces_on(i)[p] = T(now[layout_.port[i] + p]);
                if (known_[i].empty() && pushed_[i].empty()) {
                    ws_.pending[i] = 1;
                    continue;
                }
                Visit<T> v;
                v.made = ws_.used[s], v.forces = forces_on(i), v.made_in = sample_;
                v.inputs = known_[i].data(), v.n_inputs = int(known_[i].size());
                v.loads = pushed_[i].data(), v.n_loads = int(pushed_[i].size());
                bring_near(i, v.made);
                visit<T, true, false, false>(components_[i], x(i), y(i), kept(i), v, nullptr, nullptr);
                ws_.kept_at[i] = v.made;
            }
        }
    }

    // Rows of a component from the first-th on.
    void rows(int i, int first, int b, double* lines) {
        using S = Simd<T>;
        const Component<T>& c = components_[i];
        double* line = lines + std::size_t(b) * layout_.width + layout_.row[i];
        const T *sx = x(i), *sy = y(i);
        for (int r = first; r < c.n_rows; ++r) {
            const T *rx = &c.rows[2 * std::size_t(r) * c.n], *ry = rx + c.n;
            V sum{}, more{};
            for (int k = 0; k < c.n; k += kWidth) {
                sum += S::load(rx + k) * S::load(sx + k);
                more += S::load(ry + k) * S::load(sy + k);
            }
            line[r] = S::sum(sum + more);
        }
    }

    // Coordinates before the step in ws.y, and in ws.u their sum with those after it without forces.
    void coordinates(int i) {
        using S = Simd<T>;
        const Component<T>& c = components_[i];
        const int n = c.n;
        const T *const sx = x(i), *const sy = y(i), *const readings = c.stretched.reading.data();
        const T *const e00 = c.e.data(), *const e01 = e00 + n;
        T *const here = buffer(ws_.y, i), *const both = buffer(ws_.u, i);
        for (int k = 0; k < n; k += kWidth) {
            const V a = S::load(sx + k), reading = S::load(readings + k);
            V free = S::load(e00 + k) * a + S::load(e01 + k) * S::load(sy + k);
            for (const Input<T>& in : known_[i]) free += S::load(in.vector + k) * T(in.values[sample_ * in.stride]);
            S::store(here + k, reading * a);
            S::store(both + k, reading * (a + free));
        }
    }

    // The part of the gaps that the tensions do not change, gamma g - offset.
    void gaps_at_start(const double* lines) {
        std::fill(ws_.fixed.begin(), ws_.fixed.end(), 0.0);
        const double* line = lines + std::size_t(sample_) * layout_.width;
        for (const auto& t : tensions_.terms) {
            const double old = line[layout_.row[t.component] + t.port];
            ws_.fixed[t.connection] += solve_.gamma[t.connection] * t.factor * old;
            if (components_[t.component].stretched.on)
                ws_.fixed[t.connection] -= t.factor * old;  // their free displacement counts from the old one
            else
                ws_.fixed[t.connection] += t.factor * line[layout_.width + layout_.row[t.component] + t.port];
        }
        for (int j = 0; j < solve_.m; ++j) ws_.fixed[j] -= tensions_.offset[j];
    }

    // f = -M^-1 v, by an inverse made earlier in the block and corrections with M itself.
    bool solve_linear(const double* M, const double* v, double* f) {
        const int m = solve_.m;
        double *now = ws_.solution.data(), *wrong = ws_.wrong.data();
        for (int attempt = 0; attempt < 2; ++attempt) {
            const bool fresh = attempt > 0 || !ws_.inverted;
            if (fresh) invert(M);
            ws_.inverted = true;
            std::fill_n(now, m, 0.0);
            for (int correction = 0; correction < 12; ++correction) {
                double change = 0.0, size = 0.0;
                for (int i = 0; i < m; ++i) wrong[i] = -v[i] - dot(M + std::size_t(i) * m, now, m);
                for (int i = 0; i < m; ++i) {
                    const double sum = dot(&ws_.inverse[std::size_t(i) * m], wrong, m);
                    now[i] += sum;
                    change = std::max(change, std::abs(sum) * ws_.scale[i]);
                    size = std::max(size, std::abs(now[i]) * ws_.scale[i]);
                }
                if (change <= kForceTolerance<T> * size) {
                    std::copy_n(now, m, f);
                    return true;
                }
            }
            if (fresh) break;  // or else the tensions have gone too far from where the inverse was made
        }
        std::copy_n(now, m, f);
        for (int i = 0; i < m; ++i)
            if (!std::isfinite(f[i])) return false;
        return true;
    }

    // ws.inverse of a matrix by Gauss and Jordan with pivots on the diagonal, after scaling it to ones there; a redundant
    // connection, whose pivot vanishes, takes no force. ws.scale holds the roots of the diagonal.
    void invert(const double* matrix) {
        const int m = solve_.m;
        double *a = ws_.inverse.data(), *d = ws_.scale.data();
        for (int j = 0; j < m; ++j) {
            d[j] = matrix[j * m + j] > 0.0 ? std::sqrt(matrix[j * m + j]) : 0.0;
            ws_.done[j] = 0;
        }
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j) a[i * m + j] = d[i] * d[j] > 0.0 ? matrix[i * m + j] / (d[i] * d[j]) : 0.0;
        for (int turn = 0; turn < m; ++turn) {
            int p = -1;
            for (int j = 0; j < m; ++j)
                if (!ws_.done[j] && (p < 0 || std::abs(a[j * m + j]) > std::abs(a[p * m + p]))) p = j;
            const double pivot = a[p * m + p];
            if (!(std::abs(pivot) > 1e-12)) break;
            ws_.done[p] = 1;
            a[p * m + p] = 1.0;
            for (int j = 0; j < m; ++j) a[p * m + j] /= pivot;
            for (int i = 0; i < m; ++i) {
                if (i == p) continue;
                const double ratio = a[i * m + p];
                a[i * m + p] = 0.0;
                for (int j = 0; j < m; ++j) a[i * m + j] -= ratio * a[p * m + j];
            }
        }
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j)
                a[i * m + j] = ws_.done[i] && ws_.done[j] ? a[i * m + j] / (d[i] * d[j]) : 0.0;
    }

    T* buffer(Array<char>& bytes, int i) const { return reinterpret_cast<T*>(bytes.data()) + components_[i].offset; }

    const std::vector<Component<T>>& components_;
    const Layout& layout_;
    const Solve& solve_;
    const Tensions& tensions_;
    TensionSpace& ws_;
    TensePorts& ports_;
    Statistics& statistics_;
    const Job<T>& job_;
    const std::vector<std::vector<Input<T>>>& known_;
    int sample_ = 0;
    bool strong_ = false, linear_known_ = false;
    double largest_ = 0.0;  // rise of a mode's stiffness
    const double* line_ = nullptr;
    const double *onto_ = ports_.onto_ports.data(), *fixed_ = ports_.fixed.data();
    Direct at_once_;
    std::vector<std::vector<Load<T>>> pushed_;  // forces on guarded ports, by component
    Array<T> forces_;                           // on fixed ports, of the step found last
};

}  // namespace
}  // namespace tonewood
