// The kinds of potentials that act both ways.
#pragma once

#include "longitudinal.hpp"
#include "tension.hpp"
#include "user.hpp"

namespace tonewood {
namespace {

inline std::vector<std::unique_ptr<PotentialGroup>> make_potential_groups(PotentialRun& run) {
    std::vector<std::unique_ptr<PotentialGroup>> groups;
    const auto& all = run.t.two_way;
    for (int first = 0, end = 0; first < int(all.size()); first = end) {
        while (end < int(all.size()) && all[end].kind == all[first].kind) ++end;
        switch (all[first].kind) {
            case Potentials::tension: groups.push_back(std::make_unique<ModulatedTensions>(run, first, end)); break;
            case Potentials::longitudinal:
                groups.push_back(std::make_unique<StretchedStrings>(run, first, end));
                break;
            default: groups.push_back(std::make_unique<UserPotentials>(run, first, end));
        }
        for (PotentialPart& part : run.parts)
            if (part.part->potential >= first && part.part->potential < end) part.group = groups.back().get();
    }
    return groups;
}

}  // namespace
}  // namespace tonewood
