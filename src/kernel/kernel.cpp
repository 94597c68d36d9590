#include "kernel.hpp"

#include <algorithm>
#include <cmath>

#include "load/component.hpp"
#include "load/contact_groups.hpp"
#include "load/layout.hpp"
#include "load/parts.hpp"
#include "load/potentials.hpp"

namespace tonewood {

#if defined(TONEWOOD_HAVE_X86)
extern const Table table_avx512;
extern const Table table_avx2;
#endif
extern const Table table_baseline;

namespace {

constexpr std::size_t kMemory[Potentials::n_kinds] = {3, 3, kPhantomMemory, 3};  // numbers of a potential in the state
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
    model_.components.resize(n_components), space_.recurrences.resize(n_components);
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
    for (std::size_t j = 0; j < space_.contacts.acted.size(); ++j)
        if (space_.contacts.acted[j]) out.push_back(int(j));
    return out;
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
        space_.recurrences[slot] = components[slot].recurrence.numbers;
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

bool Kernel::load_potentials(const std::vector<PotentialDescription>& all, bool components_changed) {
    Potentials& t = model_.potentials;
    const std::vector<Potentials::One> before = std::move(t.two_way);
    t.two_way.clear(), t.driven.clear(), t.stretches.clear(), t.users.clear(), t.memory = 0;
    std::vector<Array<double>> vectors;  // of the strings that are driven
    for (std::size_t s = 0; s < all.size(); ++s) {
        const PotentialDescription& d = all[s];
        const std::string name = "potentials[" + std::to_string(s) + "].";
        t.memory = std::max(t.memory, d.at + kMemory[d.kind]);
        if (d.kind == Potentials::phantom) {
            t.driven.push_back(load_phantom(d, model_.components, name));
            vectors.push_back(d.vector.copy());
            continue;
        }
        Potentials::One one;
        one.kind = d.kind, one.at = d.at, one.scale = d.scale, one.components = d.slots;
        if (d.kind == Potentials::longitudinal)
            one.data = int(t.stretches.size()), t.stretches.push_back(load_stretch(d, model_.components, name));
        if (d.kind == Potentials::user)
            one.data = int(t.users.size()), t.users.push_back(load_user(d, model_.components, name));
        t.two_way.push_back(std::move(one));
    }
    t.driven_forces = join_forces(t.driven, std::move(vectors));
    const bool same = std::equal(before.begin(), before.end(), t.two_way.begin(), t.two_way.end(),
                                 [](const auto& a, const auto& b) {
                                     return a.kind == b.kind && a.at == b.at && a.scale == b.scale &&
                                            a.components == b.components && a.kind == Potentials::tension;
                                 });
    if (same && !components_changed) t.two_way = before;  // with all that `make_potentials` derived
    return !same || components_changed;
}

void Kernel::load(const CompiledSystem& system) {
    const bool all = !loaded_;  // nothing was loaded, or a load failed half-way
    loaded_ = false;
    Model& model = model_;
    const bool changed = load_components(system, system.linear.gamma.size()) || all;
    const auto marks = [&] {
        std::vector<bool> out;
        for (const Component& c : model.components) out.push_back(c.coupled), out.push_back(c.modulated);
        return out;
    };
    const std::vector<bool> before = marks();
    mark_potentials(system.potentials, model.components);
    const bool linear = load_linear(system.linear);
    const bool laws = load_nonlinear(system.nonlinear);
    const bool potentials = load_potentials(system.potentials, changed);
    const bool marked = before != marks();
    const bool contacts = changed || laws || marked || !(model.shortcuts == system.shortcuts);
    model.shortcuts = system.shortcuts;
    for (const Potentials::One& one : model.potentials.two_way)
        for (const int i : one.components)
            require(!model.solve.in_parts || i != model.solve.hub.slot, "linear.hub: no potential may act on it");
    if (changed || linear || marked) model.layout = make_layout(model.components, model.solve, n_channels_);
    if (contacts) {
        make_groups(model.components, model.nonlinear);
        make_buffers(model.components, model.nonlinear, capacity_, space_.contacts);
    }
    if (linear || contacts || potentials) {
        make_potentials(model.components, model.solve, model.layout, model.potentials, capacity_, model.nonlinear,
                        space_.potentials);
        reset_responses(model.nonlinear, model.layout, space_.contacts);
        space_.linear_laws.known = false;
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
    require(model_.potentials.two_way.empty() || (job.phase >= 0 && (job.phase == 0 || job.phase + job.n <= kResetSteps)),
            "phase: with potentials a run that begins between two multiples of " + std::to_string(kResetSteps) +
                " samples ends at the next one");
    return table_.run(model_, space_, job);
}

}  // namespace tonewood
