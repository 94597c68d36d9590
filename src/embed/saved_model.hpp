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
    const saved::Array& array = file.floats(name);
    View out;
    out.data = array.f8.data(), out.ndim = int(array.shape.size());
    std::copy(array.shape.begin(), array.shape.end(), out.shape.begin());
    return out;
}

inline ComponentDescription component(const File& file, const std::string& at) {
    ComponentDescription d;
    d.key = file.index(at + "key"), d.offset = std::size_t(file.index(at + "offset"));
    d.driven = file.integer(at + "driven", 0, 1);
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
    d.dt = file.number(at + "dt"), d.theta = file.number(at + "theta");
    if (!(d.dt > 0.0)) file.refuse(at + "dt is not above 0");
    const std::vector<int> terms = file.integers(at + "terms", 4), kinds = file.integers(at + "kinds");
    const auto &factors = file.floats(at + "factors").f8, &numbers = file.floats(at + "numbers").f8;
    expect(at + "factors", view(file, at + "factors"), {terms.size() / 4});
    expect(at + "numbers", view(file, at + "numbers"), {kinds.size(), 8});
    for (std::size_t i = 0; i < factors.size(); ++i)
        d.terms.push_back({terms[4 * i], terms[4 * i + 1], terms[4 * i + 2], terms[4 * i + 3] != 0, factors[i]});
    d.laws.resize(kinds.size());
    for (std::size_t j = 0; j < kinds.size(); ++j) {
        Law& law = d.laws[j];
        const double* n = numbers.data() + 8 * j;
        law.kind = law_kind(kinds[j]);
        std::copy_n(n, 4, law.a);
        law.loss = n[4], law.damping = n[5], law.offset = n[6], law.velocity = n[7];
    }
    for (std::size_t i = 0; file.has(at + entry("samples", i) + "0"); ++i) {
        const std::string of = at + entry("samples", i);
        const std::size_t j = std::size_t(file.index(of + "0"));
        if (j >= d.laws.size()) file.refuse(of + "0: there is no law " + std::to_string(j));
        d.laws[j].knots = file.floats(of + "1").f8, d.laws[j].coefficients = file.floats(of + "2").f8;
    }
    d.weights = view(file, at + "weights"), d.compliance = view(file, at + "compliance");
    d.from_linear = view(file, at + "from_linear"), d.to_linear = view(file, at + "to_linear");
    d.residual = view(file, at + "residual");
    return d;
}

// Runs what throws std::invalid_argument about an array of the file; the error gets the file's name.
template <class Step>
auto naming(const File& file, const Step& step) {
    try {
        return step();
    } catch (const std::invalid_argument& fault) {
        file.refuse(fault.what());
    }
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
        s.linear.hub = {file.index("linear/hub/slot"), file.integers("linear/hub/ports"), file.integers("linear/hub/point"),
                        view(file, "linear/hub/factor"), view(file, "linear/hub/span"), view(file, "linear/hub/joined")};
    s.nonlinear = nonlinear(file, "nonlinear/");
    for (std::size_t i = 0; file.has(entry("potentials", i) + "kind"); ++i) {
        const std::string p = entry("potentials", i);
        PotentialDescription d;
        d.kind = Potentials::Kind(file.integer(p + "kind", 0, Potentials::n_kinds - 1));
        d.at = std::size_t(file.index(p + "at"));
        d.slots = file.integers(p + "slots"), d.scale = file.number(p + "scale");
        const auto given = [&](const std::string& name) { return file.has(name) ? view(file, name) : View(); };
        for (std::size_t q = 0; file.has(entry(p + "parts", q) + "slopes") || file.has(entry(p + "parts", q) + "weights"); ++q) {
            const std::string at = entry(p + "parts", q);
            d.parts.push_back({given(at + "slopes"), given(at + "weights"), given(at + "mirrored")});
        }
        if (file.has(p + "target")) d.target = file.index(p + "target");
        d.vector = given(p + "vector"), d.steps = given(p + "steps");
        s.potentials.push_back(std::move(d));
    }
    return s;  // all shortcuts on
}

// Refuses a system whose tables would take gigabytes or minutes to derive, whatever the length of its file.
inline void require_moderate(const File& file, const CompiledSystem& s) {
    constexpr double kMostNumbers = 1 << 28, kMostProducts = 1e10;
    const double m = double(s.linear.gamma.size()), k = double(s.nonlinear.laws.size()), n_components = double(s.components.size());
    double ports = 0, rising = 0, contacts = 0;
    for (const ComponentDescription& c : s.components) {
        const double own = c.w.ndim == 3 ? double(c.w.shape[0]) : 0.0;
        ports += own, rising += c.has_coordinates ? own : 0.0;
        if (const View& w = c.contact.w; c.has_contact_ports && w.ndim == 3)
            contacts += double(w.shape[0]) * (double(w.shape[0]) + own);
    }
    const bool dense = s.linear.parts.empty();
    const double numbers = (dense ? ports * (m + 4 * ports) : 0.0) + rising * (2 * rising + ports + m + k) +
                           k * (4 * k + 2 * m + n_components + ports) + contacts * kBlock +
                           double(s.linear.hub.ports.size()) * (m + ports);
    const double products = dense ? ports * m * (ports + m) : rising * rising * double(s.linear.hub.ports.size() + 8);
    if (numbers > kMostNumbers || products > kMostProducts)
        file.refuse("has more ports and connections than a saved model may have");
}

// The model at rest; pluck and process move it. Nothing is allocated in process once it has run with its largest block.
class SavedModel {
public:
    static constexpr int kMostChannels = 1024;

    // Throws std::runtime_error, one line that names file and array, where the file does not hold a model.
    explicit SavedModel(const std::string& path, const std::string& isa = "") : SavedModel(File(path), isa) {}
    explicit SavedModel(File file, const std::string& isa = "")
        : file_(std::move(file)), system_(naming(file_, [&] { return system_of(file_); })), capacity_(std::size_t(file_.index("capacity"))),
          n_channels_(int(file_.integer("n_channels", 0, kMostChannels))),
          kernel_(isa.empty() ? *instruction_sets().front() : instruction_set(isa), system_.components.size(), capacity_, n_channels_) {
        for (const char* part : {"components/", "linear/", "nonlinear/", "potentials/"})
            file_.require_all_read(part);
        std::size_t modes = 0;
        for (const ComponentDescription& c : system_.components) {
            if (c.offset != modes) file_.refuse("an offset of components is not the number of modes before it");
            modes += c.e.ndim == 2 ? c.e.shape[1] : 0;
        }
        if (modes != capacity_) file_.refuse("capacity is not the number of modes, " + std::to_string(modes));
        require_moderate(file_, system_);
        naming(file_, [&] { kernel_.load(system_); });
        while (file_.has(entry("plucks", n_plucks_) + "0/0")) known_forces(entry("plucks", n_plucks_++));
        file_.require_all_read("plucks/");
        if (file_.has("fs") && !(fs() >= 1.0 && fs() <= 1e7)) file_.refuse("fs is not 1 to 1e7 Hz");
        if (file_.has("scale")) scale();
        const std::size_t k = system_.nonlinear.laws.size();
        modes_.resize(2 * capacity_), series_.resize(k), slip_.resize(k), last_.resize(k);
        potentials_.resize(kernel_.memory());
    }
    SavedModel(const SavedModel&) = delete;

    int n_channels() const { return n_channels_; }
    std::size_t n_plucks() const { return n_plucks_; }
    double fs() const { return file_.number("fs"); }  // Hz, of the steps
    const std::vector<double>& scale() const {        // by channel, from readouts to full scale
        const Array& a = file_.floats("scale");
        if (a.shape != std::vector<std::size_t>{std::size_t(n_channels_)}) file_.refuse("scale has not one number a channel");
        return a.f8;
    }
    const File& file() const { return file_; }

    // Begin gesture i of the file now, its force times gain.
    void pluck(std::size_t i, double gain = 1.0) {
        if (i >= n_plucks_) throw std::out_of_range("there is no pluck " + std::to_string(i));
        add("plucks/" + std::to_string(i), gain);
    }

    // Begin known forces of the file now: "NAME/0/0" to "3", "NAME/1/0" and so on: slot, first step, vectors, values.
    void add(const std::string& name, double gain = 1.0) {
        for (Force& force : known_forces(name + "/")) {
            for (double& value : force.values.f8) value *= gain;
            forces_.push_back(std::move(force));
        }
    }

    // Write the next n samples of all channels, (n, n_channels). Throws where state or samples are no longer finite, or
    // the forces of nonlinear connections are not found.
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
        const Fault fault = kernel_.run(job);
        if (fault.slot == Fault::kUnsolved) throw std::runtime_error("the forces of a step were not found");
        const std::size_t size = n * std::size_t(n_channels_);
        if (fault.slot != Fault::kNone || !std::all_of(out, out + size, [](double x) { return std::isfinite(x); }))
            throw std::runtime_error("the state is no longer finite");
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

    // Known forces "NAME/0/0" to "3" and so on of the file, checked; `name` with its slash.
    std::vector<Force> known_forces(const std::string& name) const {
        constexpr std::int64_t far = std::int64_t(1) << 40;
        std::vector<Force> out;
        for (std::size_t i = 0; file_.has(name + std::to_string(i) + "/0"); ++i) {
            const std::string at = name + std::to_string(i) + "/";
            const int slot = int(file_.integer(at + "0", 0, std::int64_t(system_.components.size()) - 1));
            const std::int64_t start = file_.integer(at + "1", -far, far);
            const Array &vectors = file_.floats(at + "2"), &values = file_.floats(at + "3");
            const std::size_t n = values.shape.empty() ? 0 : values.shape[0];
            if (vectors.shape != std::vector<std::size_t>{n, 2, std::size_t(kernel_.n_modes(std::size_t(slot)))} ||
                values.shape.size() != 2)
                file_.refuse(at + "2 and 3 do not fit component " + std::to_string(slot));
            out.push_back({slot, start, &vectors, values});
        }
        return out;
    }

    File file_;
    CompiledSystem system_;  // views of file_
    std::size_t capacity_, n_plucks_ = 0;
    int n_channels_;
    Kernel kernel_;
    std::vector<double> modes_, series_, slip_, last_, potentials_, linear_, laws_;
    std::vector<Force> forces_;
};

}  // namespace tonewood::saved
