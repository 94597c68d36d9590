// The kernel: loads a compiled system and steps it. It needs no Python; bind/module.cpp is its Python interface.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "data/state.hpp"
#include "load/description.hpp"

namespace tonewood {

// Instruction sets that this machine can run, the widest first.
std::vector<const Table*> instruction_sets();
const Table& instruction_set(const std::string& name);

class Kernel {
public:
    // A state of `capacity` modes in n_components components, read into n_channels outputs.
    Kernel(const Table& table, std::size_t n_components, std::size_t capacity, int n_channels);

    // Replaces the system that was loaded before. Throws std::invalid_argument, which names the array, if something
    // does not fit; then nothing is loaded.
    void load(const CompiledSystem& system);

    // Advances the state by job.n samples. Throws if the job does not fit the system that is loaded.
    Fault run(const Job& job);

    // Keys of the components that `load` takes without arrays: those in use, and recent ones.
    std::vector<std::int64_t> cached() const;
    std::vector<int> acted() const;  // nonlinear connections with a force in the last run
    const Statistics& statistics() const { return space_.statistics; }
    std::size_t capacity() const { return capacity_; }
    int n_channels() const { return n_channels_; }
    bool loaded() const { return loaded_; }
    std::size_t n_components() const { return model_.components.size(); }
    int n_modes(std::size_t slot) const { return model_.components[slot].n; }
    int n_linear() const { return model_.solve.m; }
    int n_nonlinear() const { return model_.nonlinear.k; }
    std::size_t memory() const { return model_.potentials.memory; }  // numbers of the potentials in the state, at least

private:
    bool load_components(const CompiledSystem& system, std::size_t m);
    bool load_linear(const LinearDescription& d);
    bool load_nonlinear(const NonlinearDescription& d);
    bool load_potentials(const std::vector<PotentialDescription>& all, bool components_changed);

    const Table& table_;
    std::size_t capacity_;
    int n_channels_;
    bool loaded_ = false;
    Model model_;
    Workspace space_;
    std::vector<std::int64_t> keys_;                           // by slot, -1: empty
    std::vector<std::pair<std::int64_t, Component>> replaced_; // components in store, the oldest first
};

}  // namespace tonewood
