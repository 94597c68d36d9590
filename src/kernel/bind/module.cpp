// Python's interface to the kernel: dictionaries of arrays become a CompiledSystem, NumPy arrays a Job.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <climits>
#include <cstdint>
#include <string>

#include "../kernel.hpp"

namespace nb = nanobind;

namespace tonewood {
namespace {

using In = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Integers = nb::ndarray<const std::int64_t, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<double, nb::c_contig, nb::device::cpu>;

// The entries of a dictionary, by name in messages; the arrays live as long as the reader.
class Reader {
public:
    Reader(nb::handle values, std::string path, std::vector<nb::object>& owners)
        : path_(std::move(path)), owners_(owners) {
        if (!nb::try_cast(values, values_, false))
            throw nb::type_error(("kernel: " + path_ + " is no dictionary").c_str());
    }
    bool has(const char* key) const { return values_.contains(key); }
    Reader inner(const char* key) const { return {item(key), name(key) + ".", owners_}; }
    std::vector<Reader> each(const char* key) const {
        std::vector<Reader> out;
        for (const auto& value : get<std::vector<nb::object>>(key))
            out.emplace_back(value, name(key) + "[" + std::to_string(out.size()) + "].", owners_);
        return out;
    }
    template <class T>
    T get(const char* key) const {
        T out;
        if (!nb::try_cast(item(key), out, true)) refuse(key, "has the wrong type");
        return out;
    }
    View view(const char* key) const {
        const In a = array<In>(key, "is no C-contiguous array of float64");
        if (a.ndim() > 4) refuse(key, "has too many dimensions");
        View v;
        v.data = a.data(), v.ndim = int(a.ndim());
        for (int i = 0; i < v.ndim; ++i) v.shape[i] = a.shape(i);
        return v;
    }
    template <class A>
    A array(const char* key, const char* message) const {
        A a;
        if (!nb::try_cast(item(key), a, false)) refuse(key, message);
        owners_.push_back(item(key));
        return a;
    }

private:
    std::string name(const char* key) const { return path_ + key; }
    nb::object item(const char* key) const {
        if (!values_.contains(key)) throw nb::key_error(("kernel: " + name(key) + " is missing").c_str());
        return nb::borrow(values_[key]);
    }
    [[noreturn]] void refuse(const char* key, const char* message) const {
        throw nb::type_error(("kernel: " + name(key) + " " + message).c_str());
    }
    std::string path_;
    nb::dict values_;
    std::vector<nb::object>& owners_;
};

ComponentDescription component(const Reader& in) {
    ComponentDescription d;
    d.key = in.get<std::int64_t>("key");
    if ((d.cached = !in.has("e"))) return d;
    d.offset = in.get<std::size_t>("offset"), d.driven = in.get<bool>("driven");
    d.e = in.view("e"), d.rows = in.view("rows"), d.w = in.view("w");
    d.response = in.view("response"), d.incidence = in.view("incidence");
    d.channels = in.get<std::vector<int>>("channels"), d.difference = in.get<std::vector<int>>("difference");
    if ((d.has_contact_ports = in.has("contact_rows"))) {
        d.contact.rows = in.view("contact_rows"), d.contact.w = in.view("contact_w");
        d.contact.from_fixed = in.view("from_fixed"), d.contact.from_contact = in.view("from_contact");
        d.contact.on_rows = in.view("on_rows");
    }
    if ((d.has_coordinates = in.has("reading"))) {
        d.coordinates.reading = in.view("reading"), d.coordinates.stiffness = in.view("stiffness");
        d.coordinates.kick = in.view("kick"), d.coordinates.velocity = in.view("velocity");
        d.coordinates.a = in.view("a");
        d.coordinates.middle = in.view("middle");
    }
    return d;
}

PotentialDescription potential(const Reader& in) {
    PotentialDescription d;
    const auto kind = in.get<int>("kind");
    require(kind >= 0 && kind < Potentials::n_kinds, "potentials: no kind has the number " + std::to_string(kind));
    d.kind = Potentials::Kind(kind), d.at = in.get<std::size_t>("at"), d.slots = in.get<std::vector<int>>("slots");
    d.scale = in.get<double>("scale");
    if (in.has("parts"))
        for (const Reader& part : in.each("parts")) {
            d.parts.emplace_back();
            if (part.has("slopes")) d.parts.back().slopes = part.view("slopes");
            if (part.has("weights"))
                d.parts.back().weights = part.view("weights"), d.parts.back().mirrored = part.view("mirrored");
        }
    if (in.has("function")) {
        d.sizes = in.get<std::vector<int>>("sizes"), d.scratch = in.get<std::size_t>("scratch");
        d.function = reinterpret_cast<UserPotential::Function>(in.get<std::uintptr_t>("function"));
        d.data = reinterpret_cast<const void*>(in.get<std::uintptr_t>("data"));
    }
    if (in.has("target"))
        d.target = in.get<int>("target"), d.vector = in.view("vector"), d.steps = in.view("steps");
    return d;
}

// Law j: kind, numbers a[4], loss, damping, offset, velocity; samples (knots, coefficients); addresses of C functions.
using Samples = std::tuple<std::size_t, std::vector<double>, std::vector<double>>;
using Functions = std::tuple<std::size_t, std::vector<std::tuple<std::uintptr_t, std::uintptr_t, bool>>>;

std::vector<Law> laws(const Reader& in) {
    const auto kinds = in.array<Integers>("kinds", "is no C-contiguous array of int64");
    const View numbers = in.view("numbers");
    require(kinds.ndim() == 1, "nonlinear.kinds has one dimension");
    const std::size_t k = kinds.shape(0);
    expect("nonlinear.numbers", numbers, {k, 8});
    std::vector<Law> out(k);
    for (std::size_t j = 0; j < k; ++j) {
        const double* n = numbers.data + 8 * j;
        out[j].kind = law_kind(kinds.data()[j]);
        std::copy_n(n, 4, out[j].a);
        out[j].loss = n[4], out[j].damping = n[5], out[j].offset = n[6], out[j].velocity = n[7];
    }
    for (auto& [j, knots, coefficients] : in.get<std::vector<Samples>>("samples")) {
        require(j < k, "nonlinear.samples: there is no law " + std::to_string(j));
        out[j].knots = std::move(knots), out[j].coefficients = std::move(coefficients);
    }
    for (const auto& [j, functions] : in.get<std::vector<Functions>>("functions")) {
        require(j < k && functions.size() == 2, "nonlinear.functions: a compiled law has two functions");
        Law::Function* to[2] = {&out[j].potential, &out[j].slope};
        for (int i = 0; i < 2; ++i) {
            const auto [address, data, with_data] = functions[i];
            if (with_data)
                to[i]->with_data = reinterpret_cast<double (*)(double, void*)>(address);
            else
                to[i]->plain = reinterpret_cast<double (*)(double)>(address);
            to[i]->data = reinterpret_cast<void*>(data);
        }
    }
    return out;
}

NonlinearDescription nonlinear(const Reader& in) {
    NonlinearDescription d;
    d.dt = in.get<double>("dt"), d.theta = in.get<double>("theta"), d.laws = laws(in);
    const auto terms = in.array<Integers>("terms", "is no C-contiguous array of int64");
    const View factors = in.view("factors");
    require(terms.ndim() == 2 && terms.shape(1) == 4,
            "nonlinear.terms has the columns connection, slot, port, contact");
    expect("nonlinear.factors", factors, {terms.shape(0)});
    const auto small = [](std::int64_t x) { return x < 0 || x > INT32_MAX ? -1 : int(x); };
    for (std::size_t i = 0; i < terms.shape(0); ++i) {
        const std::int64_t* t = terms.data() + 4 * i;
        d.terms.push_back({small(t[0]), small(t[1]), small(t[2]), t[3] != 0, factors[i]});
    }
    d.weights = in.view("weights"), d.compliance = in.view("compliance"), d.from_linear = in.view("from_linear");
    d.to_linear = in.view("to_linear"), d.residual = in.view("residual");
    return d;
}

Shortcuts shortcuts(const Reader& in) {
    return {in.get<bool>("fused_pass"),  in.get<bool>("direct_step"), in.get<bool>("block_culling"),
            in.get<bool>("group_bound"), in.get<bool>("fine_bound"),  in.get<bool>("at_rest"),
            in.get<bool>("linear_laws")};
}

void load(Kernel& kernel, nb::handle description) {
    std::vector<nb::object> owners;
    const Reader in(description, "", owners);
    CompiledSystem system;
    for (const Reader& c : in.each("components")) system.components.push_back(component(c));
    const Reader linear = in.inner("linear");
    LinearDescription& to = system.linear;
    to.gamma = linear.view("gamma"), to.constant = linear.view("constant"), to.weights = linear.view("weights");
    if (!linear.has("parts"))
        to.inverse = linear.view("inverse");
    else
        for (const Reader& part : linear.each("parts"))
            to.parts.push_back({part.view("places"), part.view("inverses")});
    if (linear.has("hub")) {
        const Reader hub = linear.inner("hub");
        to.hub = {hub.get<int>("slot"), hub.get<std::vector<int>>("ports"), hub.get<std::vector<int>>("point"),
                  hub.view("factor"), hub.view("span"), hub.view("joined")};
    }
    system.nonlinear = nonlinear(in.inner("nonlinear"));
    for (const Reader& p : in.each("potentials")) system.potentials.push_back(potential(p));
    system.shortcuts = shortcuts(in.inner("shortcuts"));
    kernel.load(system);
}

void expect_shape(const char* name, const Out& a, std::initializer_list<std::size_t> shape) {
    View v;
    v.ndim = int(a.ndim());
    for (int i = 0; i < std::min(v.ndim, 4); ++i) v.shape[i] = a.shape(i);
    expect(name, v, shape);
}

// Advances `modes` (2, capacity) and `series`, `slip`, `last_force` (k) in place; fills out (n, n_channels), forces
// (n, m) and law_forces (n, k), which must be zero. Injections are (slot, first step, vectors, values), controls
// (connection, (4, n)). `phase`: samples since the last multiple of kResetSteps. Returns (slot, sample) of the first
// fault; slot -1 if there is none, -2 if forces were not found.
std::pair<int, std::int64_t> run(Kernel& kernel, Out modes, Out out, Out forces,
                                 const std::vector<std::tuple<int, std::int64_t, In, In>>& injections, Out law_forces,
                                 const std::vector<std::pair<int, In>>& controls, Out series, Out slip, Out last_force,
                                 Out potentials, int phase) {
    require(kernel.loaded(), "nothing is loaded");
    const std::size_t n = out.ndim() ? out.shape(0) : 0, k = kernel.n_nonlinear();
    expect_shape("modes", modes, {2, kernel.capacity()});
    expect_shape("out", out, {n, std::size_t(kernel.n_channels())});
    expect_shape("forces", forces, {n, std::size_t(kernel.n_linear())});
    expect_shape("law_forces", law_forces, {n, k});
    expect_shape("series", series, {k});
    expect_shape("slip", slip, {k});
    expect_shape("last_force", last_force, {k});
    expect_shape("potentials", potentials, {std::max(kernel.memory(), potentials.ndim() ? potentials.shape(0) : 0)});
    Job job;
    job.modes[0] = modes.data(), job.modes[1] = modes.data() + kernel.capacity();
    job.n = std::int64_t(n), job.out = out.data(), job.forces = forces.data(), job.n_channels = kernel.n_channels();
    job.law_forces = law_forces.data(), job.series = series.data(), job.slip = slip.data();
    job.last_force = last_force.data(), job.potentials = potentials.data(), job.phase = phase;
    for (const auto& [connection, values] : controls) {
        require(values.ndim() == 2 && values.shape(0) == 4 && values.shape(1) == n,
                "controls: (4, n) values are needed");
        job.controls.push_back({connection, values.data()});
    }
    for (const auto& [slot, first, vectors, values] : injections) {
        require(slot >= 0 && std::size_t(slot) < kernel.n_components() && vectors.ndim() == 3 && values.ndim() == 2 &&
                    vectors.shape(0) == values.shape(0) && vectors.shape(1) == 2 &&
                    vectors.shape(2) == std::size_t(kernel.n_modes(slot)),
                "injections: one does not fit its component " + std::to_string(slot));
        job.injections.push_back({slot, first, std::int64_t(values.shape(1)), int(values.shape(0)), vectors.data(),
                                  values.data()});
    }
    nb::gil_scoped_release release;
    const Fault fault = kernel.run(job);
    return {fault.slot, fault.sample};
}

}  // namespace

NB_MODULE(_kernel, m) {
    m.doc() = "Steps modal systems; see tonewood.physics.stepping.kernel.";
    nb::set_leak_warnings(false); // a process that is interrupted still holds models when it ends
    m.attr("BLOCK_SIZE") = kBlock;
    m.attr("PADDING") = kPadding;
#ifdef __clang__
    m.attr("COMPILER") = __VERSION__;
#else
    m.attr("COMPILER") = "GCC " __VERSION__;
#endif
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const Table* t : instruction_sets()) names.emplace_back(t->name);
        return names;
    });
    m.def("fma_peak", [](const std::string& isa, double seconds) { return instruction_set(isa).fma_peak(seconds); });
    nb::class_<Kernel>(m, "Kernel")
        .def("__init__",
             [](Kernel* self, const std::string& isa, std::size_t n_components, std::size_t capacity, int n_channels) {
                 new (self) Kernel(instruction_set(isa), n_components, capacity, n_channels);
             })
        .def("load", &load)
        .def("cached", &Kernel::cached)
        // arrays that are written to must be the caller's own, never converted copies
        .def("run", &run, nb::arg().noconvert(), nb::arg().noconvert(), nb::arg().noconvert(), nb::arg(),
             nb::arg().noconvert(), nb::arg(), nb::arg().noconvert(), nb::arg().noconvert(), nb::arg().noconvert(),
             nb::arg().noconvert(), nb::arg())
        .def("acted", &Kernel::acted)
        .def("statistics", [](const Kernel& kernel) {
            const Statistics& s = kernel.statistics();
            return std::vector<std::int64_t>{s.solves,    s.iterations, s.most_iterations, s.failures, s.blocks,
                                             s.rows_read, s.added};
        });
}

}  // namespace tonewood
