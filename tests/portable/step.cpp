// Steps a system saved by saved.py with the kernel alone and compares with the samples saved beside it.
//     step TOLERANCE FILE...
// prints for each file "samples  peak  largest difference / peak"; exit code 1 where the last is above TOLERANCE.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "kernel.hpp"
#include "saved.hpp"

using namespace tonewood;

namespace {

View view(const saved::File& file, const std::string& name) {
    const saved::Array& array = file[name];
    View out;
    out.data = array.f8.data(), out.ndim = int(array.shape.size());
    std::copy(array.shape.begin(), array.shape.end(), out.shape.begin());
    return out;
}

ComponentDescription component(const saved::File& file, const std::string& at) {
    ComponentDescription d;
    d.key = file.integer(at + "key"), d.offset = std::size_t(file.integer(at + "offset")), d.driven = file.integer(at + "driven");
    d.e = view(file, at + "e"), d.rows = view(file, at + "rows"), d.w = view(file, at + "w");
    d.response = view(file, at + "response"), d.incidence = view(file, at + "incidence");
    d.channels = file.integers(at + "channels"), d.difference = file.integers(at + "difference");
    if ((d.has_contact_ports = file.has(at + "contact_rows"))) {
        d.contact.rows = view(file, at + "contact_rows"), d.contact.w = view(file, at + "contact_w");
        d.contact.from_fixed = view(file, at + "from_fixed"), d.contact.from_contact = view(file, at + "from_contact");
        d.contact.on_rows = view(file, at + "on_rows");
    }
    if ((d.has_tension = file.has(at + "a"))) {
        d.tension.a = view(file, at + "a"), d.tension.half = view(file, at + "half");
        d.tension.reading = view(file, at + "reading"), d.tension.kick = view(file, at + "kick");
        d.tension.velocity = view(file, at + "velocity");
    }
    return d;
}

NonlinearDescription nonlinear(const saved::File& file, const std::string& at) {
    NonlinearDescription d;
    d.dt = file[at + "dt"].f8[0], d.theta = file[at + "theta"].f8[0];
    const std::vector<int> terms = file.integers(at + "terms"), kinds = file.integers(at + "kinds");
    const auto &factors = file[at + "factors"].f8, &numbers = file[at + "numbers"].f8;
    for (std::size_t i = 0; i < factors.size(); ++i)
        d.terms.push_back({terms[4 * i], terms[4 * i + 1], terms[4 * i + 2], terms[4 * i + 3] != 0, factors[i]});
    d.laws.resize(kinds.size());
    for (std::size_t j = 0; j < kinds.size(); ++j) {
        Law& law = d.laws[j];
        const double* n = numbers.data() + 8 * j;
        law.kind = Law::Kind(kinds[j]);
        std::copy_n(n, 4, law.a);
        law.loss = n[4], law.damping = n[5], law.offset = n[6], law.velocity = n[7];
    }
    for (std::size_t i = 0; file.has(at + saved::at("samples", i) + "0"); ++i) {
        Law& law = d.laws[std::size_t(file.integer(at + saved::at("samples", i) + "0"))];
        law.knots = file[at + saved::at("samples", i) + "1"].f8, law.coefficients = file[at + saved::at("samples", i) + "2"].f8;
    }
    d.weights = view(file, at + "weights"), d.compliance = view(file, at + "compliance");
    d.from_linear = view(file, at + "from_linear"), d.to_linear = view(file, at + "to_linear");
    d.residual = view(file, at + "residual");
    return d;
}

CompiledSystem system_of(const saved::File& file) {
    CompiledSystem s;
    for (std::size_t i = 0; file.has(saved::at("components", i) + "key"); ++i)
        s.components.push_back(component(file, saved::at("components", i)));
    s.linear = {view(file, "linear/inverse"), view(file, "linear/gamma"), view(file, "linear/constant"), view(file, "linear/weights")};
    s.nonlinear = nonlinear(file, "nonlinear/");
    for (std::size_t i = 0; file.has(saved::at("tensions/strings", i) + "0"); ++i) {
        const std::string at = saved::at("tensions/strings", i);
        s.tensions.strings.push_back({int(file.integer(at + "0")), file[at + "1"].f8[0], file.integers(at + "2")});
    }
    for (std::size_t i = 0; file.has(saved::at("geometric", i) + "scale"); ++i) {
        GeometricDescription d;
        d.scale = file[saved::at("geometric", i) + "scale"].f8[0], d.longitudinal = file.integer(saved::at("geometric", i) + "longitudinal");
        for (std::size_t p = 0; file.has(saved::at(saved::at("geometric", i) + "parts", p) + "slot"); ++p) {
            const std::string at = saved::at(saved::at("geometric", i) + "parts", p);
            d.parts.push_back({int(file.integer(at + "slot")), view(file, at + "slopes"), view(file, at + "reading"),
                               view(file, at + "compliances"), view(file, at + "kick"), view(file, at + "to_port"),
                               view(file, at + "from_port")});
        }
        s.geometric.push_back(std::move(d));
    }
    return s;  // all shortcuts on
}

bool same(const char* path, double tolerance) {
    const saved::File file(path);
    const auto& wanted = file["samples"];
    const CompiledSystem system = system_of(file);
    const std::size_t n = wanted.shape[0], capacity = std::size_t(file.integer("capacity"));
    const std::size_t m = system.linear.gamma.size(), k = system.nonlinear.laws.size();
    Kernel kernel(instruction_set("baseline"), system.components.size(), capacity, int(wanted.shape[1]));
    kernel.load(system);
    std::vector<double> modes(2 * capacity), out(wanted.f8.size()), forces(n * m), law_forces(n * k), series(k), slip(k),
        last(k), tension(4 * kernel.n_tensions());
    Job job;
    job.modes[0] = modes.data(), job.modes[1] = modes.data() + capacity;
    job.n = std::int64_t(n), job.out = out.data(), job.forces = forces.data(), job.n_channels = kernel.n_channels();
    job.law_forces = law_forces.data(), job.series = series.data(), job.slip = slip.data();
    job.last_force = last.data(), job.tension = tension.data();
    for (std::size_t i = 0; file.has(saved::at("injections", i) + "0"); ++i) {
        const std::string at = saved::at("injections", i);
        const auto &vectors = file[at + "2"], &values = file[at + "3"];
        job.injections.push_back({int(file.integer(at + "0")), file.integer(at + "1"), std::int64_t(values.shape[1]),
                                  int(values.shape[0]), vectors.f8.data(), values.f8.data()});
    }
    const Fault fault = kernel.run(job);
    double peak = 0, off = 0;
    for (std::size_t i = 0; i < out.size(); ++i) {
        peak = std::max(peak, std::abs(wanted.f8[i]));
        off = std::max(off, std::abs(out[i] - wanted.f8[i]));
    }
    std::printf("%zu %.3e %.3e\n", n, peak, off / peak);
    return fault.slot == Fault::kNone && peak > 0 && off <= tolerance * peak;
}

}  // namespace

int main(int count, char** paths) {
    bool good = count > 2;
    for (int i = 2; i < count; ++i) good = same(paths[i], std::stod(paths[1])) && good;
    return good ? 0 : 1;
}
