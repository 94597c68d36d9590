// Python's door to the kernel: copies model arrays in, checks every shape, runs without the GIL.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <stdexcept>
#include <string>

#include "model.hpp"

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
template <class T>
using InT = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;

void expect(const char* what, const In& a, std::initializer_list<std::size_t> shape) {
    bool same = a.ndim() == shape.size();
    std::size_t i = 0;
    for (std::size_t n : shape) {
        same = same && a.shape(i) == n;
        ++i;
    }
    if (!same) throw std::invalid_argument(std::string("kernel array has the wrong shape: ") + what);
}

template <class T>
class Kernel {
public:
    Kernel(const std::string& isa, std::size_t n_components, std::size_t capacity, int n_channels)
        : run_(pick(find(isa))), capacity_(capacity), n_channels_(n_channels), components_(n_components) {}

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

        Component<T> c;
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
        laid_out_ = false;
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

    // Advances `modes` (2, capacity) in place; fills out (n, n_channels) and forces (n, m).
    // Returns (slot, sample) of the first fault, slot -1 if there is none.
    std::pair<int, std::int64_t> run(nb::ndarray<T, nb::c_contig, nb::device::cpu> modes,
                                     nb::ndarray<double, nb::c_contig, nb::device::cpu> out,
                                     nb::ndarray<double, nb::c_contig, nb::device::cpu> forces,
                                     const std::vector<std::tuple<int, std::int64_t, InT<T>, In>>& injections) {
        for (const auto& c : components_)
            for (const auto& shares : c.shares)
                for (const Share& s : shares)
                    if (s.connection >= solve_.m) throw std::invalid_argument("set_solve has fewer connections");
        if (modes.ndim() != 2 || modes.shape(0) != 2 || modes.shape(1) != capacity_)
            throw std::invalid_argument("the state has the wrong shape");
        if (out.ndim() != 2 || forces.ndim() != 2 || out.shape(1) != std::size_t(n_channels_) ||
            forces.shape(1) != std::size_t(solve_.m) || out.shape(0) != forces.shape(0))
            throw std::invalid_argument("the outputs have the wrong shape");
        std::vector<Injection<T>> known;
        for (const auto& [slot, first, vectors, values] : injections) {
            if (slot < 0 || std::size_t(slot) >= components_.size() || vectors.ndim() != 3 || values.ndim() != 2 ||
                vectors.shape(0) != values.shape(0) || vectors.shape(1) != 2 ||
                vectors.shape(2) != std::size_t(components_[slot].n))
                throw std::invalid_argument("an injection does not fit its component");
            known.push_back({slot, first, std::int64_t(values.shape(1)), int(values.shape(0)), vectors.data(),
                             values.data()});
        }
        Job<T> job;
        job.modes[0] = modes.data(), job.modes[1] = modes.data() + capacity_;
        job.n = std::int64_t(out.shape(0)), job.out = out.data(), job.forces = forces.data();
        job.n_channels = n_channels_, job.injections = known.data(), job.n_injections = int(known.size());
        if (!laid_out_) lay_out();
        nb::gil_scoped_release release;
        const Fault fault = run_(components_, layout_, solve_, job);
        return {fault.slot, fault.sample};
    }

private:
    // What the recurrences need, computed in double whatever T is.
    static void derive(Component<T>& c, const double* e, const double* rows, const double* w) {
        const std::size_t n = c.n;
        c.turn.resize(n), c.kappa.resize(n), c.e_block.resize(4 * n);
        c.slopes.resize(c.rows.size()), c.w_slope.resize(c.w.size());
        for (std::size_t k = 0; k < n; ++k) {
            const double a = e[k], b = e[n + k], g = e[2 * n + k], d = e[3 * n + k];
            c.turn[k] = T(a + d - 1);
            c.kappa[k] = T((1 - a) * (1 - d) - b * g);
            double p[4] = {a, b, g, d};
            for (int squared = 1; squared < kBlock; squared *= 2) {
                const double q[4] = {p[0] * p[0] + p[1] * p[2], p[1] * (p[0] + p[3]), p[2] * (p[0] + p[3]),
                                     p[1] * p[2] + p[3] * p[3]};
                for (int i = 0; i < 4; ++i) p[i] = q[i];
            }
            T turn[4] = {T(p[0]), T(p[1]), T(p[2]), T(p[3])};
            // rounded inwards, like E itself: a mode must not grow by the rounding of its propagator
            if constexpr (sizeof(T) < sizeof(double)) {
                const double exact = p[0] * p[3] - p[1] * p[2];
                for (int tries = 0; tries < 4 && double(turn[0]) * turn[3] - double(turn[1]) * turn[2] > exact; ++tries)
                    for (T& t : turn) t = std::nextafter(t, T(0));
            }
            for (int i = 0; i < 4; ++i) c.e_block[i * n + k] = turn[i];
            for (int r = 0; r < c.n_rows; ++r) {
                const double rx = rows[2 * r * n + k], ry = rows[(2 * r + 1) * n + k];
                c.slopes[2 * r * n + k] = T(rx * (a - 1) + ry * g);
                c.slopes[(2 * r + 1) * n + k] = T(rx * b + ry * (d - 1));
            }
            for (int q = 0; q < c.n_ports; ++q) {
                const double wx = w[2 * q * n + k], wy = w[(2 * q + 1) * n + k];
                c.w_slope[2 * q * n + k] = T((1 - d) * wx + b * wy);
                c.w_slope[(2 * q + 1) * n + k] = T(g * wx + (1 - a) * wy);
            }
        }
    }

    // Gives every row and port its place and folds the connections into small matrices; see Layout.
    void lay_out() {
        layout_ = Layout{};
        auto& l = layout_;
        const auto padded = [](int n) { return (n + kLane - 1) / kLane * kLane; };
        const auto alone = [](const Component<T>& c) { return !c.driven && c.n_ports <= 1; };
        const int m = solve_.m;
        int n_ports = 0;
        for (const auto& c : components_) l.port.push_back(n_ports), n_ports += c.n_ports;
        l.row.assign(components_.size(), 0);
        l.driven_history.resize(components_.size());
        for (std::size_t i = 0; i < components_.size(); ++i) {
            const auto& c = components_[i];
            if (!alone(c)) continue;
            l.row[i] = int(l.singles.size());
            l.singles.insert(l.singles.end(), c.n_rows, c.n_ports ? l.port[i] : -1);
        }
        l.single_width = l.width = padded(int(l.singles.size()));
        l.single_history.assign(std::size_t(kBlock) * l.single_width, 0.0);
        for (std::size_t i = 0; i < components_.size(); ++i) {
            const auto& c = components_[i];
            if (c.driven) {
                auto& h = l.driven_history[i];
                h.assign(std::size_t(c.n_ports) * c.n_rows * 2 * kBlock, 0.0);
                for (int k = 0; k < kBlock; ++k)
                    for (int pr = 0; pr < c.n_ports * c.n_rows; ++pr)
                        h[std::size_t(pr) * 2 * kBlock + kBlock + k] = c.history[k * c.n_ports * c.n_rows + pr];
            }
            if (c.driven || c.n_ports == 0) continue;
            if (alone(c)) {
                for (int k = 0; k < kBlock; ++k)
                    for (int r = 0; r < c.n_rows; ++r)
                        l.single_history[std::size_t(k) * l.single_width + l.row[i] + r] = c.history[k * c.n_rows + r];
                continue;
            }
            const int width = padded(c.n_rows);
            l.row[i] = l.width, l.width += width;
            Array<double> history(std::size_t(kBlock) * c.n_ports * width, 0.0);
            for (int kp = 0; kp < kBlock * c.n_ports; ++kp)
                for (int r = 0; r < c.n_rows; ++r) history[std::size_t(kp) * width + r] = c.history[kp * c.n_rows + r];
            l.several.push_back({l.row[i], l.port[i], c.n_ports, width, std::move(history)});
        }
        l.f_width = padded(m), l.force_width = padded(n_ports);
        l.constant = solve_.constant;
        l.constant.resize(l.f_width, 0.0);
        l.push.assign(std::size_t(m) * l.force_width, 0.0);
        Array<double> of_old;
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
                l.pull.insert(l.pull.end(), pull.begin(), pull.end());
                of_old.insert(of_old.end(), pull_old.begin(), pull_old.end());
            }
        l.pull.insert(l.pull.end(), of_old.begin(), of_old.end());
        laid_out_ = true;
    }

    static Run<T> pick(const Table& table) {
        if constexpr (sizeof(T) == sizeof(double))
            return table.run_f64;
        else
            return table.run_f32;
    }
    Run<T> run_;
    std::size_t capacity_;
    int n_channels_;
    std::vector<Component<T>> components_;
    Layout layout_;
    bool laid_out_ = false;
    Solve solve_;
};

template <class T>
void bind(nb::module_& m, const char* name) {
    using K = Kernel<T>;
    nb::class_<K>(m, name)
        .def(nb::init<const std::string&, std::size_t, std::size_t, int>())
        .def("set_component", &K::set_component)
        .def("set_solve", &K::set_solve)
        .def("run", &K::run);
}

}  // namespace

NB_MODULE(_kernel, m) {
    m.doc() = "Steps modal systems; see tonewood.numerics.kernel.";
    m.attr("BLOCK_SIZE") = kBlock;
    m.attr("PADDING") = kPadding;
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const Table* t : supported()) names.emplace_back(t->name);
        return names;
    });
    m.def("fma_peak", [](const std::string& isa, double seconds) { return find(isa).fma_peak(seconds); });
    bind<double>(m, "KernelF64");
    bind<float>(m, "KernelF32");
}

}  // namespace tonewood
