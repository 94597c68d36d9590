#include "kernel.hpp"

#include <algorithm>
#include <cmath>

#include "load/component.hpp"
#include "load/contacts.hpp"
#include "load/layout.hpp"
#include "load/parts.hpp"
#include "load/tension.hpp"

namespace tonewood {

#if defined(TONEWOOD_HAVE_X86)
extern const Table table_avx512;
extern const Table table_avx2;
#endif
extern const Table table_baseline;

namespace {

constexpr std::size_t kStored = 4;  // replaced components in store for each slot

// Whether `to` was another array; it is this one now.
bool assign(Array<double>& to, const View& from) {
    if (from.equals(to)) return false;
    to = from.copy();
    return true;
}

// Refuses a law without the numbers or functions of its kind.
void expect_law(const Law& law, std::size_t j) {
    const std::string number = std::to_string(j);
    const std::vector<double>& knots = law.knots;
    bool rises = knots.size() >= 2 && std::isfinite(knots.front()) && std::isfinite(knots.back());
    for (std::size_t i = 1; i < knots.size(); ++i) rises = rises && knots[i - 1] < knots[i];
    const bool has_none = knots.empty() && law.coefficients.empty();
    require(has_none ? law.kind != Law::sampled : (rises && law.coefficients.size() == 4 * (knots.size() - 1)),
            "nonlinear.samples: law " + number + " is missing, or has not rising knots and 4 coefficients between two");
    const auto known = [](const Law::Function& f) { return f.plain || f.with_data; };
    require(law.kind != Law::compiled || (known(law.potential) && known(law.slope)),
            "nonlinear.functions: law " + number + " is missing");
}

}  // namespace

std::vector<const Table*> instruction_sets() {
    std::vector<const Table*> tables;
#if defined(TONEWOOD_HAVE_X86)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("fma"))
        tables.push_back(&table_avx512);
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) tables.push_back(&table_avx2);
#endif
    tables.push_back(&table_baseline);
    return tables;
}

const Table& instruction_set(const std::string& name) {
    for (const Table* t : instruction_sets())
        if (name == t->name) return *t;
    throw std::invalid_argument("this machine has no instruction set '" + name + "'");
}

Kernel::Kernel(const Table& table, std::size_t n_components, std::size_t capacity, int n_channels)
    : table_(table), capacity_(capacity), n_channels_(n_channels), keys_(n_components, -1) {
    model_.components.resize(n_components);
}

std::vector<std::int64_t> Kernel::cached() const {
    std::vector<std::int64_t> keys;
    for (const std::int64_t key : keys_)
        if (key >= 0) keys.push_back(key);
    for (const auto& stored : replaced_) keys.push_back(stored.first);
    return keys;
}

std::vector<int> Kernel::acted() const {
    std::vector<int> out;
    for (std::size_t j = 0; j < model_.contacts.acted.size(); ++j)
        if (model_.contacts.acted[j]) out.push_back(int(j));
    return out;
}

std::size_t Kernel::n_tensions() const {
    std::size_t n = 0;
    for (const auto& string : model_.tensions.strings) n = std::max(n, std::size_t(string.index) + 1);
    return n;
}

std::size_t Kernel::n_phantoms() const {
    std::size_t n = 0;
    for (const auto& string : model_.phantoms) n = std::max(n, std::size_t(string.index) + 1);
    return n;
}

void Kernel::load_phantoms(const std::vector<PhantomDescription>& strings) {
    const auto& components = model_.components;
    std::vector<PhantomString> out;
    for (std::size_t q = 0; q < strings.size(); ++q) {
        const PhantomDescription& d = strings[q];
        const std::string name = "phantoms[" + std::to_string(q) + "].";
        require(d.index >= 0 && std::size_t(d.index) < components.size(), name + "index is out of range");
        require(d.target >= 0 && std::size_t(d.target) < components.size() && !components[d.target].driven &&
                    !components[d.target].geometric && !components[d.target].tension.on,
                name + "target: no force can act on component " + std::to_string(d.target));
        require(d.steps.ndim == 2 && d.steps.shape[0] >= 1 && d.steps.shape[0] <= kPhantomModes,
                name + "steps: 1 to " + std::to_string(kPhantomModes) + " modes are allowed");
        const std::size_t order = d.steps.shape[0];
        expect(name + "steps", d.steps, {order, 4});
        expect(name + "vector", d.vector, {2, std::size_t(components[d.target].n)});
        PhantomString string;
        string.index = d.index, string.target = d.target, string.order = int(order), string.scale = d.scale;
        string.vector = d.vector.copy(), string.steps.assign(4 * kPhantomModes, 0.0);
        for (std::size_t m = 0; m < order; ++m)
            for (std::size_t i = 0; i < 4; ++i) string.steps[i * kPhantomModes + m] = d.steps[4 * m + i];
        for (const auto& p : d.parts) {
            const bool known = p.slot >= 0 && std::size_t(p.slot) < components.size() && p.weights.ndim == 2;
            const std::size_t n = known ? p.weights.shape[1] : 0, wide = (n + kPadding - 1) / kPadding * kPadding;
            require(n > 0 && n <= std::size_t(components[p.slot].n) && !components[p.slot].driven &&
                        !components[p.slot].geometric && !components[p.slot].tension.on,
                    name + "parts: one does not fit component " + std::to_string(p.slot));
            expect(name + "weights", p.weights, {order + 1, n});
            expect(name + "mirrored", p.mirrored, {order + 1, order});
            PhantomString::Part part;
            part.slot = p.slot, part.wide = int(wide);
            part.weights.assign(padded(order + 1) * wide, 0.0), part.mirrored.assign((order + 1) * kPhantomModes, 0.0);
            for (std::size_t m = 0; m <= order; ++m) {
                std::copy_n(p.weights.data + m * n, n, part.weights.data() + m * wide);
                std::copy_n(p.mirrored.data + m * order, order, part.mirrored.data() + m * kPhantomModes);
            }
            string.parts.push_back(std::move(part));
        }
        out.push_back(std::move(string));
    }
    model_.phantoms = std::move(out);
}

bool Kernel::load_components(const CompiledSystem& system, std::size_t m) {
    auto& components = model_.components;
    require(system.components.size() == components.size(), "components: " + std::to_string(system.components.size()) +
                                                               " given, not " + std::to_string(components.size()));
    bool changed = false;
    for (std::size_t slot = 0; slot < components.size(); ++slot) {
        const ComponentDescription& d = system.components[slot];
        if (d.key >= 0 && d.key == keys_[slot]) continue;
        changed = true;
        const auto at =
            std::find_if(replaced_.begin(), replaced_.end(), [&](const auto& c) { return c.first == d.key; });
        require(d.cached ? d.key >= 0 && at != replaced_.end() : true, "components[" + std::to_string(slot) +
                                                                           "]: no component with the key " +
                                                                           std::to_string(d.key) + " is cached");
        Component next;
        if (at != replaced_.end()) {
            next = std::move(at->second);
            replaced_.erase(at);
        } else {
            next = load_component(d, slot, capacity_, n_channels_);
        }
        if (keys_[slot] >= 0) replaced_.emplace_back(keys_[slot], std::move(components[slot]));
        components[slot] = std::move(next), keys_[slot] = d.key;
    }
    // only now, since a later slot may take an entry that an earlier one would have displaced
    const std::size_t most = kStored * components.size();
    if (replaced_.size() > most) replaced_.erase(replaced_.begin(), replaced_.end() - std::ptrdiff_t(most));
    for (std::size_t slot = 0; slot < components.size(); ++slot)
        for (const auto& shares : components[slot].shares)
            for (const Share& s : shares)
                require(std::size_t(s.connection) < m,
                        "components[" + std::to_string(slot) +
                            "].incidence acts on more connections than linear.gamma has");
    return changed;
}

bool Kernel::load_linear(const LinearDescription& d) {
    const std::size_t m = d.gamma.size();
    expect("linear.gamma", d.gamma, {m});
    expect("linear.constant", d.constant, {m});
    expect("linear.weights", d.weights, {std::size_t(n_channels_), m});
    Solve& s = model_.solve;
    bool changed = s.m != int(m);
    s.m = int(m);
    if (d.parts.empty()) expect("linear.inverse", d.inverse, {m, m});
    changed |= load_parts(d, s, model_.components);
    changed |= s.in_parts ? !s.g.empty() : assign(s.g, d.inverse);
    if (s.in_parts) s.g.clear();
    changed |= assign(s.gamma, d.gamma), changed |= assign(s.constant, d.constant);
    return assign(s.weights, d.weights) || changed;
}

bool Kernel::load_nonlinear(const NonlinearDescription& d) {
    const std::size_t k = d.laws.size(), m = model_.solve.m;
    expect("nonlinear.weights", d.weights, {std::size_t(n_channels_), k});
    expect("nonlinear.compliance", d.compliance, {k, k});
    expect("nonlinear.from_linear", d.from_linear, {k, m});
    expect("nonlinear.to_linear", d.to_linear, {m, k});
    expect("nonlinear.residual", d.residual, {k, k});
    for (const Nonlinear::Term& t : d.terms)
        require(t.connection >= 0 && std::size_t(t.connection) < k && t.component >= 0 &&
                    std::size_t(t.component) < model_.components.size() && t.port >= 0,
                "nonlinear.terms: connection " + std::to_string(t.connection) + " does not fit the components");
    for (std::size_t j = 0; j < k; ++j) expect_law(d.laws[j], j);
    Nonlinear& nl = model_.nonlinear;
    bool changed =
        nl.k != int(k) || nl.dt != d.dt || nl.theta != d.theta || nl.all_terms != d.terms || nl.laws != d.laws;
    nl.k = int(k), nl.dt = d.dt, nl.theta = d.theta, nl.all_terms = d.terms, nl.laws = d.laws;
    changed |= assign(nl.compliance, d.compliance), changed |= assign(nl.from_linear, d.from_linear);
    changed |= assign(nl.residual, d.residual), changed |= assign(nl.weights, d.weights);
    const std::size_t f_width = padded(m);
    Array<double> to_linear(k * f_width, 0.0);
    for (std::size_t i = 0; i < m; ++i)
        for (std::size_t j = 0; j < k; ++j) to_linear[j * f_width + i] = d.to_linear[i * k + j];
    changed |= nl.to_linear != to_linear;
    nl.to_linear = std::move(to_linear);
    nl.read_forces.clear();
    for (std::size_t j = 0; j < k; ++j)
        for (int o = 0; o < n_channels_; ++o)
            if (nl.weights[std::size_t(o) * k + j] != 0.0) {
                nl.read_forces.push_back(int(j));
                break;
            }
    if (changed) make_series(nl);
    return changed;
}

bool Kernel::load_tensions(const TensionsDescription& d, bool components_changed) {
    Tensions& t = model_.tensions;
    std::vector<Tensions::String> strings;
    std::vector<int> components;
    for (Component& c : model_.components) c.tension.on = c.geometric = false;
    require(d.stretches.empty() || d.stretches.size() == d.strings.size(),
            "tensions.stretches: one for each string is needed");
    for (std::size_t s = 0; s < d.strings.size(); ++s) {
        const auto& string = d.strings[s];
        const std::string name = "tensions[" + std::to_string(s) + "]";
        require(string.index >= 0 && std::size_t(string.index) < model_.components.size(),
                name + ": no tension " + std::to_string(string.index));
        require(!string.slots.empty(), name + ": no components");
        for (const int i : string.slots) {
            require(i >= 0 && std::size_t(i) < model_.components.size(), name + ": no component " + std::to_string(i));
            Component& c = model_.components[i];
            require(!c.tension.a.empty(), name + ": component " + std::to_string(i) + " was loaded without `tension`");
            require(!c.tension.on && !c.geometric, name + ": component " + std::to_string(i) + " is in two strings");
            (d.stretches.empty() ? c.tension.on : c.geometric) = true;
            if (d.stretches.empty()) components.push_back(i);
        }
        strings.emplace_back();
        strings.back().index = string.index, strings.back().kappa = string.kappa;
        strings.back().components = string.slots;
    }
    const bool same = d.stretches.empty() && t.stretches.empty() &&
                      std::equal(strings.begin(), strings.end(), t.strings.begin(), t.strings.end(),
                                 [](const auto& a, const auto& b) {
                                     return a.index == b.index && a.kappa == b.kappa && a.components == b.components;
                                 });
    if (same && !components_changed) return false;
    for (std::size_t s = 0; s < d.stretches.size(); ++s) {
        std::vector<int> slots;
        for (const auto& part : d.stretches[s].parts) slots.push_back(part.slot);
        require(slots == d.strings[s].slots,
                "tensions.stretches[" + std::to_string(s) + "].parts are not the components of the string");
    }
    t.stretches = load_stretches(d.stretches, model_.components);
    t.strings = std::move(strings), t.components = std::move(components);  // `make_tensions` derives the rest
    return true;
}

void Kernel::load(const CompiledSystem& system) {
    const bool all = !loaded_;  // nothing was loaded, or a load failed half-way
    loaded_ = false;
    Model& model = model_;
    const bool changed = load_components(system, system.linear.gamma.size()) || all;
    std::vector<bool> before;
    for (const Component& c : model.components) before.push_back(c.geometric), before.push_back(c.tension.on);
    const bool linear = load_linear(system.linear);
    const bool laws = load_nonlinear(system.nonlinear);
    const bool tensions = load_tensions(system.tensions, changed);
    std::vector<bool> after;
    for (const Component& c : model.components) after.push_back(c.geometric), after.push_back(c.tension.on);
    load_phantoms(system.phantoms);
    const bool contacts = changed || laws || before != after || !(model.shortcuts == system.shortcuts);
    model.shortcuts = system.shortcuts;
    for (const Tensions::String& string : model.tensions.strings)
        for (const int i : string.components)
            require(!model.solve.in_parts || i != model.solve.hub.slot, "linear.hub: its tension may not rise");
    if (changed || linear) model.layout = make_layout(model.components, model.solve, n_channels_);
    if (contacts) {
        make_groups(model.components, model.nonlinear);
        make_buffers(model.components, model.nonlinear, capacity_, model.contacts);
    }
    if (changed || linear || contacts || tensions) {
        make_tensions(model.components, model.solve, model.layout, model.tensions, capacity_, model.nonlinear,
                      model.tension);
        reset_responses(model.nonlinear, model.layout, model.contacts);
        model.linear_laws.known = false;
    }
    loaded_ = true;
}

Fault Kernel::run(const Job& job) {
    require(loaded_, "nothing is loaded");
    for (const Control& control : job.controls)
        require(control.connection >= 0 && control.connection < model_.nonlinear.k,
                "controls: no nonlinear connection " + std::to_string(control.connection));
    for (const Injection& in : job.injections)
        require(in.slot >= 0 && std::size_t(in.slot) < model_.components.size(),
                "injections: no component " + std::to_string(in.slot));
    require(model_.tensions.strings.empty() || (job.phase >= 0 && (job.phase == 0 || job.phase + job.n <= kResetSteps)),
            "phase: with rising tensions a run that begins between two multiples of " + std::to_string(kResetSteps) +
                " samples ends at the next one");
    return table_.run(model_, job);
}

}  // namespace tonewood
