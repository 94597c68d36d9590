// A model that Python has assembled and saved (tonewood.sound.render.model_file), stepped by the kernel without Python.
#pragma once

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../kernel/kernel.hpp"
#include "arrays.hpp"

namespace tonewood::saved {

inline View view(const File& file, const std::string& name) {
    const saved::Array& array = file[name];
    View out;
    out.data = array.f8.data(), out.ndim = int(array.shape.size());
    std::copy(array.shape.begin(), array.shape.end(), out.shape.begin());
    return out;
}

inline ComponentDescription component(const File& file, const std::string& at) {
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
    if ((d.has_coordinates = file.has(at + "reading"))) {
        d.coordinates.reading = view(file, at + "reading"), d.coordinates.stiffness = view(file, at + "stiffness");
        d.coordinates.kick = view(file, at + "kick"), d.coordinates.velocity = view(file, at + "velocity");
        d.coordinates.a = view(file, at + "a");
        d.coordinates.middle = view(file, at + "middle");
    }
    return d;
}

inline NonlinearDescription nonlinear(const File& file, const std::string& at) {
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
    for (std::size_t i = 0; file.has(at + entry("samples", i) + "0"); ++i) {
        Law& law = d.laws[std::size_t(file.integer(at + entry("samples", i) + "0"))];
        law.knots = file[at + entry("samples", i) + "1"].f8, law.coefficients = file[at + entry("samples", i) + "2"].f8;
    }
    d.weights = view(file, at + "weights"), d.compliance = view(file, at + "compliance");
    d.from_linear = view(file, at + "from_linear"), d.to_linear = view(file, at + "to_linear");
    d.residual = view(file, at + "residual");
    return d;
}

inline CompiledSystem system_of(const File& file) {
    CompiledSystem s;
    for (std::size_t i = 0; file.has(entry("components", i) + "key"); ++i)
        s.components.push_back(component(file, entry("components", i)));
    s.linear.gamma = view(file, "linear/gamma"), s.linear.constant = view(file, "linear/constant");
    s.linear.weights = view(file, "linear/weights");
    if (file.has("linear/inverse")) s.linear.inverse = view(file, "linear/inverse");
    for (std::size_t i = 0; file.has(entry("linear/parts", i) + "places"); ++i)
        s.linear.parts.push_back({view(file, entry("linear/parts", i) + "places"), view(file, entry("linear/parts", i) + "inverses")});
    if (file.has("linear/hub/slot"))
        s.linear.hub = {int(file.integer("linear/hub/slot")), file.integers("linear/hub/ports"), file.integers("linear/hub/point"),
                        view(file, "linear/hub/factor"), view(file, "linear/hub/span"), view(file, "linear/hub/joined")};
    s.nonlinear = nonlinear(file, "nonlinear/");
    for (std::size_t i = 0; file.has(entry("potentials", i) + "kind"); ++i) {
        const std::string p = entry("potentials", i);
        PotentialDescription d;
        d.kind = Potentials::Kind(file.integer(p + "kind")), d.at = std::size_t(file.integer(p + "at"));
        d.slots = file.integers(p + "slots"), d.scale = file[p + "scale"].f8[0];
        const auto given = [&](const std::string& name) { return file.has(name) ? view(file, name) : View(); };
        for (std::size_t q = 0; file.has(entry(p + "parts", q) + "slopes") || file.has(entry(p + "parts", q) + "weights"); ++q) {
            const std::string at = entry(p + "parts", q);
            d.parts.push_back({given(at + "slopes"), given(at + "weights"), given(at + "mirrored")});
        }
        if (file.has(p + "target")) d.target = int(file.integer(p + "target"));
        d.vector = given(p + "vector"), d.steps = given(p + "steps");
        s.potentials.push_back(std::move(d));
    }
    return s;  // all shortcuts on
}

// The model at rest; pluck and process move it. Nothing is allocated in process once it has run with its largest block.
class SavedModel {
public:
    explicit SavedModel(const std::string& path, const std::string& isa = "")
        : file_(path), system_(system_of(file_)), capacity_(std::size_t(file_.integer("capacity"))),
          n_channels_(int(file_.integer("n_channels"))),
          kernel_(isa.empty() ? *instruction_sets().front() : instruction_set(isa), system_.components.size(), capacity_, n_channels_) {
        kernel_.load(system_);
        const std::size_t k = system_.nonlinear.laws.size();
        modes_.resize(2 * capacity_), series_.resize(k), slip_.resize(k), last_.resize(k);
        potentials_.resize(kernel_.memory());
        for (std::size_t i = 0; file_.has("plucks/" + std::to_string(i) + "/0/0"); ++i) ++n_plucks_;
    }
    SavedModel(const SavedModel&) = delete;

    int n_channels() const { return n_channels_; }
    std::size_t n_plucks() const { return n_plucks_; }
    const File& file() const { return file_; }

    // Begin gesture i of the file now, its force times gain.
    void pluck(std::size_t i, double gain = 1.0) { add("plucks/" + std::to_string(i), gain); }

    // Begin known forces of the file now: "NAME/0/0" to "3", "NAME/1/0" and so on: slot, first step, vectors, values.
    void add(const std::string& name, double gain = 1.0) {
        for (std::size_t i = 0; file_.has(entry(name, i) + "0"); ++i) {
            const Array &vectors = file_[entry(name, i) + "2"], &values = file_[entry(name, i) + "3"];
            Force force{int(file_.integer(entry(name, i) + "0")), file_.integer(entry(name, i) + "1"), &vectors, values};
            for (double& value : force.values.f8) value *= gain;
            forces_.push_back(std::move(force));
        }
    }

    // Write the next n samples of all channels, (n, n_channels). Throws where the state is no longer finite.
    void process(double* out, std::size_t n) {
        const std::size_t m = system_.linear.gamma.size(), k = system_.nonlinear.laws.size();
        linear_.resize(std::max(linear_.size(), n * m));
        laws_.assign(std::max(laws_.size(), n * k), 0.0);
        Job job;
        job.modes[0] = modes_.data(), job.modes[1] = modes_.data() + capacity_;
        job.n = std::int64_t(n), job.out = out, job.forces = linear_.data(), job.n_channels = n_channels_;
        job.law_forces = laws_.data(), job.series = series_.data(), job.slip = slip_.data();
        job.last_force = last_.data(), job.potentials = potentials_.data();
        for (const Force& f : forces_)
            job.injections.push_back({f.slot, f.start, std::int64_t(f.values.shape[1]), int(f.values.shape[0]),
                                      f.vectors->f8.data(), f.values.f8.data()});
        if (kernel_.run(job).slot != Fault::kNone) throw std::runtime_error("the state is no longer finite");
        for (Force& f : forces_) f.start -= std::int64_t(n);
        std::erase_if(forces_, [](const Force& f) { return f.start + std::int64_t(f.values.shape[1]) <= 0; });
    }

private:
    struct Force {
        int slot;
        std::int64_t start;  // from the next sample on
        const Array* vectors;
        Array values;
    };
    File file_;
    CompiledSystem system_;
    std::size_t capacity_, n_plucks_ = 0;
    int n_channels_;
    Kernel kernel_;
    std::vector<double> modes_, series_, slip_, last_, potentials_, linear_, laws_;
    std::vector<Force> forces_;
};

}  // namespace tonewood::saved
