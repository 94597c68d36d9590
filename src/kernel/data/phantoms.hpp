// Strings whose longitudinal motion is driven one way (modal/phantom_step.hpp).
#pragma once

#include "component.hpp"

namespace tonewood {

constexpr int kPhantomModes = 32;                            // longitudinal modes of a string at most
constexpr int kPhantomMemory = kBlock + 2 * kPhantomModes;   // numbers of a string in the state

struct PhantomString {
    struct Part {  // a polarization: its lowest n modes
        int slot = 0, wide = 0;  // component; these modes, padded as all are
        Array<double> weights;   // (order + 1, padded to kLane; wide)
        Array<double> mirrored;  // (order + 1, kPhantomModes)
        bool operator==(const Part&) const = default;
    };
    int index = 0;               // of its row in the state
    int target = 0;              // component that its force acts on
    int order = 0;               // longitudinal modes
    double scale = 0;            // EA
    Array<double> vector;        // (2, n) state that 1 N, held over a step, adds there
    Array<double> steps;         // (4, kPhantomModes)
    std::vector<Part> parts;
    bool operator==(const PhantomString&) const = default;
};

}  // namespace tonewood
