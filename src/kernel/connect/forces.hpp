// All that finds the forces of a run's connections and potentials, made once for a run.
#pragma once

#include <optional>

#include "../potentials/kinds.hpp"
#include "law_forces.hpp"

namespace tonewood {
namespace {

struct Forces {
    Block& block;
    ForcesInParts parts;  // of the linear connections, where they are solved in parts
    ContactRows rows;
    BroadPhase cull;
    Series series;
    std::optional<PotentialSolve> potentials;
    LawForces laws;

    explicit Forces(Block& b)
        : block(b), parts(b.model.layout), rows(b), cull(b, rows), series(b.model.nonlinear, b.space.contacts),
          potentials(made(b, parts)), laws(b, parts, rows, cull, series, potentials ? &*potentials : nullptr) {}
    Forces(const Forces&) = delete;

private:
    static std::optional<PotentialSolve> made(Block& block, ForcesInParts& parts) {
        if (block.model.potentials.two_way.empty()) return {};
        return std::optional<PotentialSolve>(std::in_place, block, parts);
    }
};

}  // namespace
}  // namespace tonewood
