// Python's door to the kernel: copies model arrays in, checks every shape, runs without the GIL.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "prepare.hpp"

static_assert((tonewood::kBlock & (tonewood::kBlock - 1)) == 0, "E^kBlock is made by squaring");

namespace nb = nanobind;

namespace tonewood {

#if defined(TONEWOOD_HAVE_X86)
extern const Table table_avx512;
extern const Table table_avx2;
#endif
extern const Table table_baseline;

namespace {

std::vector<const Table*> supported() {
    std::vector<const Table*> tables;
#if defined(TONEWOOD_HAVE_X86)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("fma"))
        tables.push_back(&table_avx512);
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) tables.push_back(&table_avx2);
#endif
    tables.push_back(&table_baseline);
    return tables;
}

const Table& find(const std::string& isa) {
    for (const Table* t : supported())
        if (isa == t->name) return *t;
    throw std::invalid_argument("this machine has no instruction set '" + isa + "'");
}

using In = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

void expect(const char* what, const In& a, std::initializer_list<std::size_t> shape) {
    bool same = a.ndim() == shape.size();
    std::size_t i = 0;
    for (std::size_t n : shape) {
        same = same && a.shape(i) == n;
        ++i;
    }
    if (!same) throw std::invalid_argument(std::string("kernel array has the wrong shape: ") + what);
}

// A law as Python gives it: kind, numbers a[4], loss, damping, offset, velocity; samples; addresses of C functions.
using LawArrays = std::tuple<int, std::vector<double>, std::vector<double>, std::vector<double>,
                             std::vector<std::tuple<std::uintptr_t, std::uintptr_t, bool>>>;

Law make_law(const LawArrays& given) {
    const auto& [kind, numbers, knots, coefficients, functions] = given;
    if (kind < Law::contact || kind > Law::friction || numbers.size() != 8)
        throw std::invalid_argument("no such law");
    Law law;
    law.kind = Law::Kind(kind);
    std::copy_n(numbers.begin(), 4, law.a);
    law.loss = numbers[4], law.damping = numbers[5], law.offset = numbers[6], law.velocity = numbers[7];
    law.knots = knots, law.coefficients = coefficients;
    if (law.kind == Law::sampled && (knots.size() < 2 || coefficients.size() != 4 * (knots.size() - 1)))
        throw std::invalid_argument("a sampled law has the wrong shape");
    if (law.kind == Law::compiled) {
        if (functions.size() != 2) throw std::invalid_argument("a compiled law has two functions");
        Law::Function* to[2] = {&law.potential, &law.slope};
        for (int i = 0; i < 2; ++i) {
            const auto [address, data, with_data] = functions[i];
            if (address == 0) throw std::invalid_argument("a compiled law has no function");
            if (with_data)
                to[i]->with_data = reinterpret_cast<double (*)(double, void*)>(address);
            else
                to[i]->plain = reinterpret_cast<double (*)(double)>(address);
            to[i]->data = reinterpret_cast<void*>(data);
        }
    }
    return law;
}

constexpr std::size_t kUntold = -1;
constexpr std::size_t kAside = 4;  // components put aside for each one there is

using GeometricArrays = std::tuple<int, In, In, In, In, In, In>;

class Kernel {
public:
    Kernel(const std::string& isa, std::size_t n_components, std::size_t capacity, int n_channels)
        : run_(find(isa).run), capacity_(capacity), n_channels_(n_channels), components_(n_components) {}

    void set_component(std::size_t slot, std::size_t offset, bool driven, In e, In rows, In w, In history, In incidence,
                       const std::vector<int>& channels, const std::vector<int>& difference) {
        if (slot >= components_.size()) throw std::invalid_argument("no such component slot");
        if (e.ndim() != 2 || rows.ndim() != 3 || w.ndim() != 3 || incidence.ndim() != 2)
            throw std::invalid_argument("kernel array has the wrong number of dimensions");
        const std::size_t n = e.shape(1), n_rows = rows.shape(0), n_ports = w.shape(0);
        expect("e", e, {4, n});
        expect("rows", rows, {n_rows, 2, n});
        expect("w", w, {n_ports, 2, n});
        expect("history", history, {kBlock, n_ports, n_rows});
        if (n % kPadding != 0 || offset % kPadding != 0 || offset + n > capacity_)
            throw std::invalid_argument("a component's modes do not fit the state");
        const std::size_t read = channels.size() + (driven ? 0 : n_ports);
        if (n_rows != read || difference.size() != channels.size())
            throw std::invalid_argument("a component's rows do not fit its ports and readouts");
        for (int channel : channels)
            if (channel < 0 || channel >= n_channels_) throw std::invalid_argument("no such channel");
        if (incidence.shape(1) != n_ports) throw std::invalid_argument("incidence does not fit the ports");

        Component c;
        c.n = int(n), c.n_ports = int(n_ports), c.n_rows = int(n_rows), c.offset = offset, c.driven = driven;
        c.e.assign(e.data(), e.data() + e.size());
        c.rows.assign(rows.data(), rows.data() + rows.size());
        c.w.assign(w.data(), w.data() + w.size());
        c.history.assign(history.data(), history.data() + history.size());
        derive(c, e.data(), rows.data(), w.data());
        c.shares.resize(n_ports);
        for (std::size_t j = 0; j < incidence.shape(0); ++j)
            for (std::size_t p = 0; p < n_ports; ++p)
                if (const double a = incidence.data()[j * n_ports + p]; a != 0.0)
                    c.shares[p].push_back({int(j), a});
        c.channels = channels;
        c.difference.assign(difference.begin(), difference.end());
        components_[slot] = std::move(c);
        laid_out_ = arranged_ = false;
    }

    // Puts a component aside under a number, with all that was made of it.
    void set_aside(std::size_t slot, std::int64_t number) {
        if (slot >= components_.size()) throw std::invalid_argument("no such component slot");
        if (aside_.size() >= kAside * components_.size()) aside_.erase(aside_.begin());
        aside_.emplace_back(number, std::move(components_[slot]));
        components_[slot] = {};
        laid_out_ = arranged_ = false;
    }

    // Takes the component of this number back; false if it is not there.
    bool take_back(std::size_t slot, std::int64_t number) {
        if (slot >= components_.size()) throw std::invalid_argument("no such component slot");
        const auto at = std::find_if(aside_.begin(), aside_.end(), [&](const auto& c) { return c.first == number; });
        if (at == aside_.end()) return false;
        components_[slot] = std::move(at->second);
        aside_.erase(at);
        laid_out_ = arranged_ = false;
        return true;
    }

    // Ports that only contacts act on, of a component just set; histories are (kBlock, forced port, row).
    void set_guarded(std::size_t slot, In e, In rows, In w, In from_fixed, In from_guarded, In on_rows) {
        if (slot >= components_.size()) throw std::invalid_argument("no such component slot");
        Component& c = components_[slot];
        const std::size_t n = c.n, fixed = c.n_ports, count = rows.ndim() == 3 ? rows.shape(0) : 0;
        expect("e", e, {4, n});
        expect("guarded rows", rows, {count, 2, n});
        expect("guarded w", w, {count, 2, n});
        expect("from_fixed", from_fixed, {kBlock, fixed, count});
        expect("from_guarded", from_guarded, {kBlock, count, count});
        expect("on_rows", on_rows, {kBlock, count, std::size_t(c.n_rows)});
        if (c.driven) throw std::invalid_argument("a component driven one way has no guarded ports");
        Guarded& guarded = c.guarded;
        guarded.n = int(count);
        guarded.rows.assign(rows.data(), rows.data() + rows.size());
        guarded.w.assign(w.data(), w.data() + w.size());
        guarded.slopes = slopes_of(n, e.data(), rows.data(), count);
        guarded.w_slope = w_slopes_of(c, e.data(), w.data(), count);
        const auto by_pair = [](const In& h) {
            const std::size_t pairs = h.shape(1) * h.shape(2);
            Array<double> out(pairs * kBlock);
            for (std::size_t k = 0; k < kBlock; ++k)
                for (std::size_t i = 0; i < pairs; ++i) out[i * kBlock + k] = h.data()[k * pairs + i];
            return out;
        };
        guarded.from_fixed = by_pair(from_fixed), guarded.from_guarded = by_pair(from_guarded);
        const std::size_t n_rows = c.n_rows;
        guarded.on_rows.resize(on_rows.size());
        for (std::size_t k = 0; k < kBlock; ++k)
            for (std::size_t p = 0; p < count; ++p)
                std::copy_n(on_rows.data() + (k * count + p) * n_rows, n_rows,
                            guarded.on_rows.data() + ((p * kBlock + k) * n_rows));
        derive_bounds(c, e.data(), rows.data());
        derive_energy(c);
        laid_out_ = arranged_ = false;
    }

    // k connections; terms are (connection, slot, port, guarded, factor). Call before set_laws and set_gaps.
    void set_nonlinear(std::size_t k, const std::vector<std::tuple<int, int, int, bool, double>>& terms, double dt,
                       double theta, bool guarded, In weights) {
        expect("weights", weights, {std::size_t(n_channels_), k});
        Nonlinear nl;
        nl.k = int(k), nl.dt = dt, nl.theta = theta, nl.asleep_allowed = guarded;
        nl.laws.resize(k);
        for (const auto& [connection, slot, port, is_guarded, factor] : terms) {
            if (connection < 0 || std::size_t(connection) >= k || slot < 0 || std::size_t(slot) >= components_.size() ||
                port < 0)
                throw std::invalid_argument("a nonlinear connection does not fit the components");
            nl.all_terms.push_back({connection, slot, port, is_guarded, factor});
        }
        nl.weights.assign(weights.data(), weights.data() + weights.size());
        for (std::size_t j = 0; j < k; ++j)
            for (std::size_t o = 0; o < std::size_t(n_channels_); ++o)
                if (nl.weights[o * k + j] != 0.0) {
                    nl.heard.push_back(int(j));
                    break;
                }
        nonlinear_ = std::move(nl);
        nonlinear_m_ = kUntold;
        laid_out_ = arranged_ = false;
    }

    // Laws of some of them.
    void set_laws(const std::vector<std::pair<int, LawArrays>>& laws) {
        for (const auto& [j, law] : laws) {
            if (j < 0 || j >= nonlinear_.k) throw std::invalid_argument("no such connection");
            nonlinear_.laws[j] = make_law(law);
        }
        laid_out_ = arranged_ = false;
    }

    // What their gaps give way by, the linear connections left out, and these (m, k) and (k, m). Call after set_solve.
    void set_gaps(In compliance, In from_linear, In to_linear, In residual) {
        Nonlinear& nl = nonlinear_;
        const std::size_t k = nl.k, m = solve_.m;
        expect("compliance", compliance, {k, k});
        expect("from_linear", from_linear, {k, m});
        expect("to_linear", to_linear, {m, k});
        expect("residual", residual, {k, k});
        nl.compliance.assign(compliance.data(), compliance.data() + compliance.size());
        nl.from_linear.assign(from_linear.data(), from_linear.data() + from_linear.size());
        nl.residual.assign(residual.data(), residual.data() + residual.size());
        const std::size_t f_width = (m + kLane - 1) / kLane * kLane;
        nl.to_linear.assign(k * f_width, 0.0);
        for (std::size_t i = 0; i < m; ++i)
            for (std::size_t j = 0; j < k; ++j) nl.to_linear[j * f_width + i] = to_linear.data()[i * k + j];
        // gaps that share residual compliance
        nl.series.assign(k, -1), nl.n_series = 0;
        std::vector<std::size_t> open;
        for (std::size_t j = 0; j < k; ++j) {
            if (nl.series[j] >= 0 || nl.residual[j * k + j] == 0.0) continue;
            open.push_back(j);
            nl.series[j] = nl.n_series;
            while (!open.empty()) {
                const std::size_t i = open.back();
                open.pop_back();
                for (std::size_t q = 0; q < k; ++q)
                    if (nl.series[q] < 0 && nl.residual[i * k + q] != 0.0) nl.series[q] = nl.n_series, open.push_back(q);
            }
            ++nl.n_series;
        }
        nonlinear_m_ = m;
        laid_out_ = arranged_ = false;
    }

    // Weights and responses of a string's modes, of a component just set: a, half, reading (n), kick (2, n), E (4, n).
    void set_stretched(std::size_t slot, In a, In half, In reading, In kick, In e) {
        if (slot >= components_.size()) throw std::invalid_argument("no such component slot");
        Component& c = components_[slot];
        const std::size_t n = c.n, p = c.n_ports;
        expect("a", a, {n});
        expect("half", half, {n});
        expect("reading", reading, {n});
        expect("kick", kick, {2, n});
        expect("e", e, {4, n});
        if (c.driven || n == 0 || p > kMaxStretchedPorts) throw std::invalid_argument("a stretched string has too many ports");
        Stretched& s = c.stretched;
        s.a.assign(a.data(), a.data() + n), s.half.assign(half.data(), half.data() + n);
        s.reading.assign(reading.data(), reading.data() + n), s.kick.assign(kick.data(), kick.data() + 2 * n);
        s.most_half = *std::max_element(half.data(), half.data() + n);
        s.gain.assign(2 * n, 0.0);
        for (std::size_t k = 0; k < 2 * n; ++k)
            if (const double r = reading.data()[k % n]; r != 0.0) s.gain[k] = kick.data()[k] / r;
        derive_taut(c, e.data(), s.gain.data());
        s.phi.assign(p * n, 0.0), s.c.assign(p * n, 0.0);
        for (std::size_t q = 0; q < p; ++q)
            for (std::size_t k = 0; k < n; ++k) {
                if (reading.data()[k] == 0.0) continue;
                s.phi[q * n + k] = c.rows[2 * q * n + k] / reading.data()[k];
                s.c[q * n + k] = reading.data()[k] * c.w[2 * q * n + k];
            }
        const Guarded& g = c.guarded;
        s.guarded_phi.assign(g.n * n, 0.0), s.guarded_c.assign(g.n * n, 0.0);
        for (std::size_t q = 0; q < std::size_t(g.n); ++q)
            for (std::size_t k = 0; k < n; ++k) {
                if (reading.data()[k] == 0.0) continue;
                s.guarded_phi[q * n + k] = g.rows[2 * q * n + k] / reading.data()[k];
                s.guarded_c[q * n + k] = reading.data()[k] * g.w[2 * q * n + k];
            }
        derive_pulled(c);
        laid_out_ = arranged_ = false;
    }

    // Strings whose tension is on: (index in the state, kappa, components); matrix (m, m) and offset (m) of the linear
    // connections, f = -matrix^-1 (g_free + gamma g - offset). Call after set_solve.
    void set_tensions(const std::vector<std::tuple<int, double, std::vector<int>>>& strings, In matrix, In offset) {
        const std::size_t m = solve_.m;
        expect("matrix", matrix, {m, m});
        expect("offset", offset, {m});
        const std::vector<Tensions::String> before = std::move(tensions_.strings);
        tensions_ = Tensions{};
        for (const auto& [index, kappa, parts] : strings) {
            for (const int i : parts)
                if (i < 0 || std::size_t(i) >= components_.size()) throw std::invalid_argument("no such component slot");
            if (index < 0) throw std::invalid_argument("no such tension");
            tensions_.strings.push_back({index, kappa, parts});
        }
        tensions_.matrix.assign(matrix.data(), matrix.data() + matrix.size());
        tensions_.offset.assign(offset.data(), offset.data() + offset.size());
        laid_out_ = false;
        arranged_ = arranged_ && std::ranges::equal(before, tensions_.strings, {}, &Tensions::String::components,
                                                    &Tensions::String::components);
    }

    void set_solve(In g, In gamma, In constant, In weights) {
        const std::size_t m = gamma.size();
        expect("g", g, {m, m});
        expect("gamma", gamma, {m});
        expect("constant", constant, {m});
        expect("weights", weights, {std::size_t(n_channels_), m});
        solve_.m = int(m);
        solve_.g.assign(g.data(), g.data() + g.size());
        solve_.gamma.assign(gamma.data(), gamma.data() + m);
        solve_.constant.assign(constant.data(), constant.data() + m);
        laid_out_ = false;
        solve_.weights.assign(weights.data(), weights.data() + weights.size());
    }

    // Advances `modes` (2, capacity) and `series`, `slip`, `last_force` (k) in place; fills out (n, n_channels), forces
    // (n, m) and law_forces (n, k), which must be zero. Controls are (connection, (4, n)).
    // Returns (slot, sample) of the first fault; slot -1 if there is none, -2 if forces were not found.
    std::pair<int, std::int64_t> run(Out modes, Out out, Out forces,
                                     const std::vector<std::tuple<int, std::int64_t, In, In>>& injections,
                                     Out law_forces, const std::vector<std::pair<int, In>>& controls, Out series,
                                     Out slip, Out last_force, Out tension) {
        for (const auto& c : components_)
            for (const auto& shares : c.shares)
                for (const Share& s : shares)
                    if (s.connection >= solve_.m) throw std::invalid_argument("set_solve has fewer connections");
        if (modes.ndim() != 2 || modes.shape(0) != 2 || modes.shape(1) != capacity_)
            throw std::invalid_argument("the state has the wrong shape");
        if (out.ndim() != 2 || forces.ndim() != 2 || out.shape(1) != std::size_t(n_channels_) ||
            forces.shape(1) != std::size_t(solve_.m) || out.shape(0) != forces.shape(0))
            throw std::invalid_argument("the outputs have the wrong shape");
        const std::size_t k = nonlinear_.k;
        if (k > 0 && nonlinear_m_ != std::size_t(solve_.m))
            throw std::invalid_argument("what nonlinear connections give way by is not told, or with other linear ones");
        if (law_forces.ndim() != 2 || law_forces.shape(0) != out.shape(0) || law_forces.shape(1) != k ||
            series.size() != k || slip.size() != k || last_force.size() != k)
            throw std::invalid_argument("the state of nonlinear connections has the wrong shape");
        for (const auto& string : tensions_.strings)
            for (const int i : string.components)
                if (components_[i].stretched.a.size() != std::size_t(components_[i].n))
                    throw std::invalid_argument("a string under tension was not told how it is stretched");
        if (!tensions_.strings.empty() && tensions_.offset.size() != std::size_t(solve_.m))
            throw std::invalid_argument("set_tensions was made for another number of connections");
        for (const auto& string : tensions_.strings)
            if (tension.ndim() != 2 || tension.shape(1) != 3 || std::size_t(string.index) >= tension.shape(0))
                throw std::invalid_argument("the state of the tensions has the wrong shape");
        std::vector<Control> moved;
        for (const auto& [connection, values] : controls) {
            expect("control", values, {4, out.shape(0)});
            if (connection < 0 || std::size_t(connection) >= k) throw std::invalid_argument("no such connection");
            moved.push_back({connection, values.data()});
        }
        std::vector<Injection> known;
        for (const auto& [slot, first, vectors, values] : injections) {
            if (slot < 0 || std::size_t(slot) >= components_.size() || vectors.ndim() != 3 || values.ndim() != 2 ||
                vectors.shape(0) != values.shape(0) || vectors.shape(1) != 2 ||
                vectors.shape(2) != std::size_t(components_[slot].n))
                throw std::invalid_argument("an injection does not fit its component");
            known.push_back({slot, first, std::int64_t(values.shape(1)), int(values.shape(0)), vectors.data(),
                             values.data()});
        }
        Job job;
        job.modes[0] = modes.data(), job.modes[1] = modes.data() + capacity_;
        job.n = std::int64_t(out.shape(0)), job.out = out.data(), job.forces = forces.data();
        job.n_channels = n_channels_, job.injections = known.data(), job.n_injections = int(known.size());
        job.law_forces = law_forces.data(), job.series = series.data(), job.slip = slip.data();
        job.tension = tension.data();
        job.last_force = last_force.data(), job.controls = moved.data(), job.n_controls = int(moved.size());
        if (!laid_out_) {
            lay_out();
            arrange(components_, solve_, layout_, tensions_, capacity_, nonlinear_, space_);
            if (!arranged_) arrange(components_, layout_, nonlinear_);
            if (!arranged_) prepare(components_, nonlinear_, capacity_, workspace_);
            make_room(nonlinear_, layout_, workspace_);
            arranged_ = true;
        }
        nb::gil_scoped_release release;
        const Fault fault = run_(components_, layout_, solve_, nonlinear_, tensions_, geometric_, workspace_, space_, statistics_, job);
        return {fault.slot, fault.sample};
    }

    // Strings whose longitudinal motion is coupled to the transverse one, their components just set or unchanged: scale,
    // whether there is one, and parts, that of it last: slot, slopes (cosines, n), reading, yields (n), kick (2, n),
    // to_port, from_port (n_ports, n). If there is none, in place of the slopes stands the stretch (1, n).
    void set_geometric(const std::vector<std::tuple<double, bool, std::vector<GeometricArrays>>>& strings) {
        for (auto& c : components_) c.geometric = false;
        geometric_.strings.clear();
        for (const auto& [scale, along, parts] : strings) add_geometric(scale, along, parts);
        laid_out_ = arranged_ = false;
    }

    // Connections that acted last, or whose forces were not found.
    std::vector<int> active() const { return workspace_.active; }

    // Nonlinear connections with a force in the last run.
    std::vector<int> acted() const {
        std::vector<int> out;
        for (std::size_t j = 0; j < workspace_.acted.size(); ++j)
            if (workspace_.acted[j]) out.push_back(int(j));
        return out;
    }

    std::vector<std::int64_t> statistics() const {
        const Statistics& s = statistics_;
        return {s.solves, s.iterations, s.most_iterations, s.failures, s.tension_iterations, s.most_tension_iterations,
                s.blocks, s.rows_read, s.woken, s.windows, s.calm};
    }

private:
    void add_geometric(double scale, bool along, const std::vector<GeometricArrays>& parts) {
        const auto padded = [](std::size_t n) { return (n + kLane - 1) / kLane * kLane; };
        if (parts.size() < (along ? 2 : 1)) throw std::invalid_argument("a geometric string without parts");
        Geometric::String string;
        string.scale = scale, string.along = along;
        for (const auto& [slot, slopes, reading, yields, kick, to_port, from_port] : parts) {
            if (slot < 0 || std::size_t(slot) >= components_.size() || slopes.ndim() != 2)
                throw std::invalid_argument("no such component slot");
            Component& c = components_[slot];
            const std::size_t n = slopes.shape(1), cosines = slopes.shape(0), p = c.n_ports, w = padded(n);
            expect("reading", reading, {n});
            expect("yields", yields, {n});
            expect("kick", kick, {2, n});
            expect("to_port", to_port, {p, n});
            expect("from_port", from_port, {p, n});
            if (c.driven || c.guarded.n || n > std::size_t(c.n) || cosines == 0 || (!along && cosines > 1))
                throw std::invalid_argument("a geometric string does not fit its component");
            Geometric::Part part;
            part.component = slot, part.n = int(n), part.width = int(w), part.cosines = int(cosines);
            part.cosines_width = int(padded(cosines));
            part.slopes.assign(n * part.cosines_width, 0.0), part.back.assign(cosines * w, 0.0);
            part.stretch.assign(w, 0.0);
            if (!along) std::copy_n(slopes.data(), n, part.stretch.begin());
            for (std::size_t i = 0; along && i < cosines; ++i)
                for (std::size_t k = 0; k < n; ++k) {
                    const double slope = slopes.data()[i * n + k];
                    part.slopes[k * part.cosines_width + i] = part.back[i * w + k] = slope;
                    part.stretch[k] += (i == 0 ? 1.0 : 0.5) * slope * slope;
                }
            const auto rows = [&](const In& a, std::size_t count) {
                Array<double> out(count * w, 0.0);
                for (std::size_t q = 0; q < count; ++q) std::copy_n(a.data() + q * n, n, out.data() + q * w);
                return out;
            };
            part.reading = rows(reading, 1), part.yields = rows(yields, 1), part.kick = rows(kick, 2);
            part.to_port = rows(to_port, p), part.from_port = rows(from_port, p);
            c.geometric = true;
            string.parts.push_back(std::move(part));
        }
        string.order = string.parts.back().cosines - 1;
        if (along) std::fill(string.parts.back().stretch.begin(), string.parts.back().stretch.end(), 0.0);
        geometric_.strings.push_back(std::move(string));
    }

    // What the recurrences need.
    static void derive(Component& c, const double* e, const double* rows, const double* w) {
        const std::size_t n = c.n;
        c.trace.resize(n), c.det.resize(n), c.kappa.resize(n), c.e_block.resize(4 * n);
        c.slow.assign((n + kGranule - 1) / kGranule, 0);
        for (std::size_t k = 0; k < n; ++k) {
            const double a = e[k], b = e[n + k], g = e[2 * n + k], d = e[3 * n + k];
            c.trace[k] = a + d, c.det[k] = a * d - b * g;
            const double kappa = c.kappa[k] = (1 - a) * (1 - d) - b * g;
            // an angle below 0.22 per sample; padding does not count
            if (kappa < 0.05) c.slow[k / kGranule] = 1;
            double p[4] = {a, b, g, d};
            for (int squared = 1; squared < kBlock; squared *= 2) {
                const double q[4] = {p[0] * p[0] + p[1] * p[2], p[1] * (p[0] + p[3]), p[2] * (p[0] + p[3]),
                                     p[1] * p[2] + p[3] * p[3]};
                for (int i = 0; i < 4; ++i) p[i] = q[i];
            }
            for (int i = 0; i < 4; ++i) c.e_block[i * n + k] = p[i];
        }
        c.slopes = slopes_of(n, e, rows, c.n_rows), c.w_slope = w_slopes_of(c, e, w, c.n_ports);
        c.woven = {};
        weave(c, e, rows, w);
    }

    // See weave.hpp; nothing is woven where a mode has several rows or cannot be told from what its row reads.
    static void weave(Component& c, const double* e, const double* rows, const double* w) {
        constexpr std::size_t chunk = kChunk;
        const std::size_t n = c.n;
        if (c.n_ports < 1 || c.n_ports > 2 || c.n_rows == 0) return;
        Woven woven;
        woven.n_ports = c.n_ports, woven.step = (4 + 2 * c.n_ports) * chunk;
        std::vector<int> row(n, -1);
        for (std::size_t k = 0; k < n; ++k) {
            bool dead = true;
            for (int i = 0; i < 4; ++i) dead = dead && e[i * n + k] == 0.0;
            for (int r = 0; r < c.n_rows; ++r)
                if (rows[2 * r * n + k] != 0.0 || rows[(2 * r + 1) * n + k] != 0.0) {
                    if (row[k] >= 0) return;
                    row[k] = r;
                }
            if (row[k] < 0 && !dead) return;
        }
        for (std::size_t k = 0; k < n;) {
            if (row[k] < 0) {
                ++k;
                continue;
            }
            std::size_t end = k;
            bool is_slow = false;
            for (; end < std::min(k + chunk, n) && row[end] == row[k]; ++end) is_slow = is_slow || c.kappa[end] < 0.02;
            const std::size_t first = k, at = woven.chunks.size();
            woven.chunks.push_back({int(k), int(end - k), row[k], is_slow});
            woven.data.resize((at + 1) * woven.step, 0.0);
            woven.doors.resize((at + 1) * Woven::door_step, 0.0);
            for (; k < end; ++k) {
                double* const data = woven.data.data() + at * woven.step + k - first;
                double* const door = woven.doors.data() + (at * Woven::door_step + k - first);
                const double a = e[k], b = e[n + k], g = e[2 * n + k], d = e[3 * n + k];
                const double rx = rows[2 * row[k] * n + k], ry = rows[(2 * row[k] + 1) * n + k], one = is_slow;
                const double tx = rx * (a - one) + ry * g, ty = rx * b + ry * (d - one);
                data[0] = is_slow ? c.kappa[k] : c.trace[k], data[chunk] = c.det[k];
                bool first_only = b == 0.0 && g == 0.0 && ry == 0.0;
                for (int p = 0; p < c.n_ports; ++p) {
                    const double wx = w[2 * p * n + k], wy = w[(2 * p + 1) * n + k];
                    first_only = first_only && wy == 0.0;
                    data[(4 + 2 * p) * chunk] = rx * wx + ry * wy, data[(5 + 2 * p) * chunk] = tx * wx + ty * wy;
                }
                door[0] = rx, door[chunk] = ry, door[2 * chunk] = tx, door[3 * chunk] = ty;
                if (first_only) {  // a real mode, whose second number is none
                    door[4 * chunk] = 1 / rx;
                    continue;
                }
                const double det = rx * ty - ry * tx;
                if (std::abs(det) < 0.02 * (std::abs(rx * ty) + std::abs(ry * tx)) || det == 0.0) return;
                door[4 * chunk] = ty / det, door[5 * chunk] = -ry / det;
                door[6 * chunk] = -tx / det, door[7 * chunk] = rx / det;
            }
        }
        c.woven = std::move(woven);
    }

    // rows (E - I), of `count` rows of n modes
    static Array<double> slopes_of(std::size_t n, const double* e, const double* rows, std::size_t count) {
        Array<double> out(2 * count * n);
        for (std::size_t r = 0; r < count; ++r)
            for (std::size_t k = 0; k < n; ++k) {
                const double rx = rows[2 * r * n + k], ry = rows[(2 * r + 1) * n + k];
                out[2 * r * n + k] = rx * (e[k] - 1) + ry * e[2 * n + k];
                out[(2 * r + 1) * n + k] = rx * e[n + k] + ry * (e[3 * n + k] - 1);
            }
        return out;
    }

    // (E - tr) w, or of slow modes (I + E - tr) w
    static Array<double> w_slopes_of(const Component& c, const double* e, const double* w, std::size_t count) {
        const std::size_t n = c.n;
        Array<double> out(2 * count * n);
        for (std::size_t q = 0; q < count; ++q)
            for (std::size_t k = 0; k < n; ++k) {
                const double wx = w[2 * q * n + k], wy = w[(2 * q + 1) * n + k];
                const double one = c.slow[k / kGranule];
                out[2 * q * n + k] = (one - e[3 * n + k]) * wx + e[n + k] * wy;
                out[(2 * q + 1) * n + k] = e[2 * n + k] * wx + (one - e[k]) * wy;
            }
        return out;
    }

    // Gives every row and port its place and folds the connections into small matrices; see Layout.
    void lay_out() {
        layout_ = Layout{};
        auto& l = layout_;
        const auto padded = [](int n) { return (n + kLane - 1) / kLane * kLane; };
        const auto alone = [](const Component& c) { return !c.driven && c.n_ports == 1 && c.n_rows == 1; };
        const int m = solve_.m;
        l.row.assign(components_.size(), 0), l.port.assign(components_.size(), 0);
        l.driven_history.resize(components_.size());
        int n_ports = 0;
        for (std::size_t i = 0; i < components_.size(); ++i)
            if (alone(components_[i])) l.row[i] = l.port[i] = n_ports++;
        l.single_width = l.width = padded(n_ports);
        l.single_history.assign(std::size_t(kBlock) * l.single_width, 0.0);
        for (std::size_t i = 0; i < components_.size(); ++i) {
            const auto& c = components_[i];
            if (alone(c)) {
                for (int k = 0; k < kBlock; ++k)
                    l.single_history[std::size_t(k) * l.single_width + l.row[i]] = c.history[k];
                continue;
            }
            l.port[i] = n_ports, n_ports += c.n_ports;
            if (c.driven) {
                auto& h = l.driven_history[i];
                h.assign(std::size_t(c.n_ports) * c.n_rows * 2 * kBlock, 0.0);
                for (int k = 0; k < kBlock; ++k)
                    for (int pr = 0; pr < c.n_ports * c.n_rows; ++pr)
                        h[std::size_t(pr) * 2 * kBlock + kBlock + k] = c.history[k * c.n_ports * c.n_rows + pr];
                continue;
            }
            const int width = padded(c.n_rows);
            l.row[i] = l.width, l.width += width;
            if (c.n_ports == 0) continue;
            Array<double> history(std::size_t(kBlock) * c.n_ports * width, 0.0);
            for (int kp = 0; kp < kBlock * c.n_ports; ++kp)
                for (int r = 0; r < c.n_rows; ++r) history[std::size_t(kp) * width + r] = c.history[kp * c.n_rows + r];
            l.several.push_back({l.row[i], l.port[i], c.n_ports, width, std::move(history)});
        }
        l.f_width = padded(m), l.force_width = padded(n_ports);
        for (int o = 0; o < n_channels_; ++o)
            for (int j = 0; j < m; ++j)
                if (const double w = solve_.weights[std::size_t(o) * m + j]; w != 0.0) l.heard.push_back({o, j, w});
        l.constant = solve_.constant;
        l.constant.resize(l.f_width, 0.0);
        l.push.assign(std::size_t(m) * l.force_width, 0.0);
        Array<double> of_free;
        for (std::size_t i = 0; i < components_.size(); ++i)
            for (int p = 0; p < components_[i].n_ports; ++p) {
                Array<double> pull(l.f_width, 0.0), pull_old(l.f_width, 0.0);
                for (const Share& s : components_[i].shares[p]) {
                    l.push[std::size_t(s.connection) * l.force_width + l.port[i] + p] += s.factor;
                    for (int k = 0; k < m; ++k) {
                        const double g = solve_.g[std::size_t(k) * m + s.connection] * s.factor;
                        pull[k] -= g, pull_old[k] -= g * solve_.gamma[s.connection];
                    }
                }
                if (components_[i].driven) continue;
                l.port_rows.push_back(l.row[i] + p);
                l.pull.insert(l.pull.end(), pull_old.begin(), pull_old.end());
                of_free.insert(of_free.end(), pull.begin(), pull.end());
            }
        l.pull.insert(l.pull.end(), of_free.begin(), of_free.end());
        const auto pushed = [&](const double* f, double* to) {
            for (int j = 0; j < m; ++j)
                for (int p = 0; p < n_ports; ++p) to[p] += f[j] * l.push[std::size_t(j) * l.force_width + p];
        };
        l.direct_constant.assign(l.force_width, 0.0);
        pushed(l.constant.data(), l.direct_constant.data());
        l.own_port.assign(m, -1), l.own_factor.assign(m, 0.0);
        for (std::size_t i = 0; i < components_.size(); ++i)
            for (int p = 0; p < components_[i].n_ports; ++p)
                if (const auto& shares = components_[i].shares[p]; shares.size() == 1 && shares[0].factor != 0.0) {
                    l.own_port[shares[0].connection] = l.port[i] + p;
                    l.own_factor[shares[0].connection] = 1.0 / shares[0].factor;
                }
        if (std::find(l.own_port.begin(), l.own_port.end(), -1) != l.own_port.end()) l.own_port.clear();
        l.own_in_order = true;
        for (int j = 0; j < m && !l.own_port.empty(); ++j) l.own_in_order = l.own_in_order && l.own_port[j] == j;
        const std::size_t n_rows = l.port_rows.size();
        l.mix = m ? solve_.gamma[0] : 0.0;
        l.direct.assign(n_rows * l.force_width, 0.0), l.direct_old.assign(n_rows * l.force_width, 0.0);
        bool mixed_alike = true;
        for (std::size_t p = 0; p < n_rows; ++p) {
            Array<double> old(l.pull.data() + p * l.f_width, l.pull.data() + ((p + 1) * l.f_width));
            for (int j = 0; j < m; ++j) old[j] -= l.mix * l.pull[(n_rows + p) * l.f_width + j];
            for (const double x : old) mixed_alike = mixed_alike && x == 0.0;
            pushed(l.pull.data() + ((n_rows + p) * l.f_width), l.direct.data() + p * l.force_width);
            pushed(old.data(), l.direct_old.data() + p * l.force_width);
            if (p && l.port_rows[p] == l.port_rows[p - 1] + 1 && l.port_rows[p] == l.segments.back().row + l.segments.back().n)
                ++l.segments.back().n;
            else
                l.segments.push_back({l.port_rows[p], int(p), 1});
        }
        if (mixed_alike) l.direct_old.clear();
        laid_out_ = true;
    }

    Run run_;
    std::size_t capacity_;
    int n_channels_;
    std::vector<Component> components_;
    std::vector<std::pair<std::int64_t, Component>> aside_;  // the one put there first is the first to go
    Layout layout_;
    bool laid_out_ = false;  // rows, ports and linear connections
    bool arranged_ = false;  // nonlinear connections
    Solve solve_;
    Nonlinear nonlinear_;
    std::size_t nonlinear_m_ = 0;  // linear connections that it was made for
    Tensions tensions_;
    Geometric geometric_;
    Workspace workspace_;
    TensionSpace space_;
    Statistics statistics_;
};

}  // namespace

NB_MODULE(_kernel, m) {
    m.doc() = "Steps modal systems; see tonewood.stepping.kernel.";
    m.attr("BLOCK_SIZE") = kBlock;
    m.attr("PADDING") = kPadding;
#ifdef __clang__
    m.attr("COMPILER") = __VERSION__;
#else
    m.attr("COMPILER") = "GCC " __VERSION__;
#endif
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const Table* t : supported()) names.emplace_back(t->name);
        return names;
    });
    m.def("fma_peak", [](const std::string& isa, double seconds) { return find(isa).fma_peak(seconds); });
    nb::class_<Kernel>(m, "Kernel")
        .def(nb::init<const std::string&, std::size_t, std::size_t, int>())
        .def("set_component", &Kernel::set_component)
        .def("set_solve", &Kernel::set_solve)
        .def("set_guarded", &Kernel::set_guarded)
        .def("set_stretched", &Kernel::set_stretched)
        .def("set_tensions", &Kernel::set_tensions)
        .def("set_geometric", &Kernel::set_geometric)
        .def("set_nonlinear", &Kernel::set_nonlinear)
        .def("set_laws", &Kernel::set_laws)
        .def("set_gaps", &Kernel::set_gaps)
        .def("set_aside", &Kernel::set_aside)
        .def("take_back", &Kernel::take_back)
        // what is written to must be the caller's own array, never a converted copy of it
        .def("run", &Kernel::run, nb::arg().noconvert(), nb::arg().noconvert(), nb::arg().noconvert(), nb::arg(),
             nb::arg().noconvert(), nb::arg(), nb::arg().noconvert(), nb::arg().noconvert(), nb::arg().noconvert(),
             nb::arg().noconvert())
        .def("active", &Kernel::active)
        .def("acted", &Kernel::acted)
        .def("statistics", &Kernel::statistics);
}

}  // namespace tonewood
