// Python's interface to the methods of the literature: copies their arrays in, checks every shape, runs without the
// GIL.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <initializer_list>
#include <stdexcept>
#include <string>

#include "explicit_laws.hpp"

namespace nb = nanobind;

namespace tonewood {

#if defined(TONEWOOD_HAVE_X86)
extern const MethodTable methods_avx512;
extern const MethodTable methods_avx2;
#endif
extern const MethodTable methods_baseline;

namespace {

const MethodTable& find(const std::string& isa) {
#if defined(TONEWOOD_HAVE_X86)
    __builtin_cpu_init();
    const bool wide = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq");
    if (isa == methods_avx512.name && wide && __builtin_cpu_supports("fma")) return methods_avx512;
    if (isa == methods_avx2.name && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        return methods_avx2;
#endif
    if (isa == methods_baseline.name) return methods_baseline;
    throw std::invalid_argument("this machine has no instruction set '" + isa + "'");
}

struct Shape {
    const char* name;
    int n_state, n_coef, n_in, n_row, n_out;
};
template <class Rule>
constexpr Shape shape_of(const char* name) {
    return {name, Rule::n_state, Rule::n_coef, Rule::n_in, Rule::n_row, Rule::n_out};
}
constexpr Shape kShapes[kMethodKinds] = {shape_of<Flow>("flow"), shape_of<AdamsBashforth>("adams_bashforth"),
                                         shape_of<Verlet>("verlet"), shape_of<Newmark>("newmark")};

int kind_of(const std::string& name) {
    for (int i = 0; i < kMethodKinds; ++i)
        if (name == kShapes[i].name) return i;
    throw std::invalid_argument("there is no rule '" + name + "'");
}

using In = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using InOut = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

template <class A>
void expect(const char* what, const A& a, std::initializer_list<std::size_t> shape) {
    bool same = a.ndim() == shape.size();
    std::size_t i = 0;
    for (std::size_t n : shape) {
        same = same && a.shape(i) == n;
        ++i;
    }
    if (!same) throw std::invalid_argument(std::string("array has the wrong shape: ") + what);
}

Array<double> copied(const In& a) { return Array<double>(a.data(), a.data() + a.size()); }

class Method {
public:
    Method(const std::string& rule, const std::string& isa, std::size_t capacity, int n_connections, int n_channels,
           int phases, int lags, const std::vector<double>& constants)
        : kind_(kind_of(rule)), run_(find(isa).run[kind_]), capacity_(capacity) {
        if (n_connections < 0 || n_channels < 0 || phases < 1 || lags < 1 || constants.size() > 4)
            throw std::invalid_argument("a method's sizes are out of range");
        plan_.m = n_connections, plan_.n_channels = n_channels, plan_.phases = phases, plan_.lags = lags;
        for (std::size_t i = 0; i < constants.size(); ++i) plan_.c[i] = constants[i];
        plan_.g_t.assign(std::size_t(phases) * n_connections * n_connections, 0.0);
    }

    void add_part(std::size_t offset, In coef, In excite, In reads, In outs, const std::vector<int>& links,
                  const std::vector<int>& channels) {
        const Shape& s = kShapes[kind_];
        if (coef.ndim() != 2) throw std::invalid_argument("array has the wrong shape: coef");
        const std::size_t n = coef.shape(1), l = links.size(), o = channels.size();
        expect("coef", coef, {std::size_t(s.n_coef), n});
        expect("excite", excite, {std::size_t(plan_.phases), l, std::size_t(plan_.lags), std::size_t(s.n_in), n});
        expect("reads", reads, {l, std::size_t(s.n_row), n});
        expect("outs", outs, {o, std::size_t(s.n_out), n});
        if (n == 0 || n % kPadding != 0 || offset % kPadding != 0 || offset + n > capacity_)
            throw std::invalid_argument("a part's modes do not fit the state");
        for (int link : links)
            if (link < 0 || link >= plan_.m) throw std::invalid_argument("no such connection");
        for (int channel : channels)
            if (channel < 0 || channel >= plan_.n_channels) throw std::invalid_argument("no such channel");
        MethodPart p;
        p.n = int(n), p.n_links = int(l), p.n_outs = int(o), p.offset = offset;
        p.coef = copied(coef), p.excite = copied(excite), p.reads = copied(reads), p.outs = copied(outs);
        p.links = links, p.channels = channels;
        plan_.parts.push_back(std::move(p));
    }

    // G and, where forces depend on the ones before, K; (phases, m, m) each
    void set_solve(In g, In memory, In out_memory) {
        const std::size_t m = plan_.m, phases = plan_.phases, channels = plan_.n_channels;
        expect("g", g, {phases, m, m});
        expect("memory", memory, {phases, m, m});
        expect("out_memory", out_memory, {phases, channels, m});
        plan_.g_t = transposed(g), plan_.memory_t = transposed(memory), plan_.out_memory = copied(out_memory);
        drop_if_zero(plan_.memory_t), drop_if_zero(plan_.out_memory);
    }

    // Advances state (n_state, capacity) and forces (lags, m) by n steps; fills out (n / every + 1, n_channels).
    std::int64_t run(InOut state, InOut forces, std::int64_t n, std::int64_t every, InOut out) {
        expect("state", state, {std::size_t(kShapes[kind_].n_state), capacity_});
        expect("forces", forces, {std::size_t(plan_.lags), std::size_t(plan_.m)});
        if (n < 0 || every < 1 || n % plan_.phases != 0) throw std::invalid_argument("no such number of steps");
        expect("out", out, {std::size_t(n / every + 1), std::size_t(plan_.n_channels)});
        if (plan_.parts.empty()) throw std::invalid_argument("a method needs parts");
        MethodJob job{};
        for (int i = 0; i < kShapes[kind_].n_state; ++i) job.state[i] = state.data() + i * capacity_;
        job.forces = forces.data(), job.n = n, job.every = every, job.out = out.data();
        nb::gil_scoped_release release;
        return run_(plan_, job);
    }

private:
    Array<double> transposed(const In& a) const {
        const std::size_t m = plan_.m;
        Array<double> out(a.size());
        for (int p = 0; p < plan_.phases; ++p)
            for (std::size_t i = 0; i < m; ++i)
                for (std::size_t j = 0; j < m; ++j) out[(p * m + j) * m + i] = a.data()[(p * m + i) * m + j];
        return out;
    }
    static void drop_if_zero(Array<double>& a) {
        for (double x : a)
            if (x != 0.0) return;
        a.clear();
    }

    int kind_;
    MethodRun run_;
    std::size_t capacity_;
    MethodPlan plan_;
};

class Explicit {
public:
    Explicit(const std::string& isa, std::size_t capacity, double h, int n_rigid, int n_channels,
             const std::vector<double>& stiffness)
        : run_(find(isa).run_explicit), capacity_(capacity) {
        if (n_rigid < 0 || n_channels < 0 || !(h > 0)) throw std::invalid_argument("a method's sizes are out of range");
        plan_.h = h, plan_.n_rigid = n_rigid, plan_.n_channels = n_channels, plan_.stiffness = stiffness;
        plan_.g_t.assign(std::size_t(n_rigid) * n_rigid, 0.0);
    }

    void add_law(bool one_sided, const std::vector<double>& a, double offset) {
        if (a.size() != 4) throw std::invalid_argument("a law has four numbers");
        plan_.laws.push_back({one_sided, {a[0], a[1], a[2], a[3]}, offset});
        plan_.exchange.assign(std::size_t(plan_.n_rigid) * plan_.laws.size(), 0.0);
    }

    void add_part(std::size_t offset, int tension, In coef, In rigid, In law, In outs,
                  const std::vector<int>& rigid_links, const std::vector<int>& law_links,
                  const std::vector<int>& channels) {
        if (coef.ndim() != 2) throw std::invalid_argument("array has the wrong shape: coef");
        const std::size_t n = coef.shape(1);
        expect("coef", coef, {3, n});
        expect("rigid", rigid, {rigid_links.size(), n});
        expect("law", law, {law_links.size(), n});
        expect("outs", outs, {channels.size(), n});
        if (n == 0 || n % kPadding != 0 || offset % kPadding != 0 || offset + n > capacity_)
            throw std::invalid_argument("a part's modes do not fit the state");
        within(rigid_links, plan_.n_rigid), within(law_links, int(plan_.laws.size()));
        within(channels, plan_.n_channels);
        if (tension < -1 || tension >= int(plan_.stiffness.size())) throw std::invalid_argument("no such tension");
        ExplicitPart p;
        p.n = int(n), p.n_rigid = int(rigid_links.size()), p.n_laws = int(law_links.size());
        p.n_outs = int(channels.size()), p.tension = tension, p.offset = offset;
        p.coef = copied(coef), p.rigid = copied(rigid), p.law = copied(law), p.outs = copied(outs);
        p.rigid_links = rigid_links, p.law_links = law_links, p.channels = channels;
        plan_.parts.push_back(std::move(p));
    }

    void set_solve(In g, In exchange) {
        const std::size_t r = plan_.n_rigid, l = plan_.laws.size();
        expect("g", g, {r, r});
        expect("exchange", exchange, {r, l});
        for (std::size_t i = 0; i < r; ++i)
            for (std::size_t j = 0; j < r; ++j) plan_.g_t[j * r + i] = g.data()[i * r + j];
        plan_.exchange = copied(exchange);
    }

    // Advances state (3, capacity) by n steps; fills out (n / every + 1, n_channels).
    std::int64_t run(InOut state, std::int64_t n, std::int64_t every, InOut out) {
        expect("state", state, {3, capacity_});
        if (n < 0 || every < 1) throw std::invalid_argument("no such number of steps");
        expect("out", out, {std::size_t(n / every + 1), std::size_t(plan_.n_channels)});
        double* const numbers[] = {state.data(), state.data() + capacity_, state.data() + 2 * capacity_};
        nb::gil_scoped_release release;
        return run_(plan_, numbers, n, every, out.data());
    }

private:
    static void within(const std::vector<int>& index, int size) {
        for (int i : index)
            if (i < 0 || i >= size) throw std::invalid_argument("no such connection or channel");
    }
    ExplicitRun run_;
    std::size_t capacity_;
    ExplicitPlan plan_;
};

}  // namespace

NB_MODULE(_methods, m) {
    m.doc() = "Steps modal systems by methods of the literature; see tonewood.lab.accuracy.schemes.";
    m.attr("PADDING") = kPadding;
    nb::class_<Method>(m, "Method")
        .def(nb::init<const std::string&, const std::string&, std::size_t, int, int, int, int,
                      const std::vector<double>&>())
        .def("add_part", &Method::add_part)
        .def("set_solve", &Method::set_solve)
        .def("run", &Method::run);
    nb::class_<Explicit>(m, "Explicit")
        .def(nb::init<const std::string&, std::size_t, double, int, int, const std::vector<double>&>())
        .def("add_law", &Explicit::add_law)
        .def("add_part", &Explicit::add_part)
        .def("set_solve", &Explicit::set_solve)
        .def("run", &Explicit::run);
}

}  // namespace tonewood
