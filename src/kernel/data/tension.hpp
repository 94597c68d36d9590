// Strings under rising tension, and strings whose longitudinal motion is stepped.
#pragma once

#include <array>

#include "component.hpp"

namespace tonewood {

// A string with longitudinal motion (connect/longitudinal.hpp).
struct Stretch {
    struct Part {  // one component's lowest n modes, those that take part
        int component = 0, n = 0, width = 0, cosines = 0, cosines_width = 0;  // widths are padded
        Array<double> slopes, back;        // (n, cosines_width), (cosines, width): slope's cosines per coordinate
        Array<double> scale;               // (n, padded as modes are): coordinate per xi of modal/scaled_modes.hpp
        Array<double> stretch, stiffness;  // (the same): own share of twice s_0; square of the frequency
    };
    int order = 0;             // P
    double scale = 0;          // EA L
    bool longitudinal = true;  // false: no longitudinal part, s_0 is the sum of stretch times squares over two
    std::vector<Part> parts;   // the longitudinal one last
};

// Strings whose tension rises (connect/rising.hpp), and the tables that load/tension.hpp derives of them.
struct Tensions {
    struct Part {  // a polarization
        int component, string, first_port;
        std::size_t sums;  // its sums of a modal pass among all
    };
    struct Port {      // a fixed port of a polarization
        // of its displacement in a line, of its force among all ports', among two-way ports
        int string, line, force, place;
        std::vector<Share> shares;       // of the linear connections
    };
    struct String {
        int index;     // of its row in the state
        double kappa;  // EA/(4 L)
        std::vector<int> components;
        int first = 0, n = 0, first_part = 0;  // its ports; its polarizations, one for each component
        Array<double> steady;           // (n) sqrt(sum h r r / 2)
        double root = 0, highest = 0;   // 2 sqrt(kappa); largest w a / 2
        // (n, n) pairs of its ports: coefficients by powers of the tension of sum q r r and of sum q^2 r r, where
        // q = h (1 - h T)
        std::vector<std::array<double, 2>> once;
        std::vector<std::array<double, 3>> twice;
    };
    std::vector<String> strings;
    std::vector<Stretch> stretches;     // by string; none where no string has longitudinal motion
    std::vector<int> components;        // of strings without longitudinal motion
    std::vector<Part> parts;            // string by string
    std::vector<Port> ports;            // part by part
    int width = 0;                      // ports, padded
    std::size_t n_sums = 0;
    Array<double> onto_ports;           // (ports, width): forces on these ports per displacement of one
    // where the linear connections are one matrix: (ports, force_width) forces on all ports, (ports, f_width) of
    // connections
    Array<double> onto_forces, onto_linear;
};

constexpr int kSharedSums = 3, kPortSums = 5;  // of a modal pass over a polarization, and for each of its ports

struct TensionState {
    Array<double> scaled;               // of modes: modal/scaled_modes.hpp
    Array<double> lanes, sums;          // of the modal passes, before and after their lanes are added
    // by string: psi and its mean over the step, with and without nonlinear connections; sizes of the direction
    // (excursion); mean tensions of the last steps
    Array<double> psi, mean, alone, spread, bound, past[3];
    // (ports): displacement per mean psi; forces of the linear connections alone, and of those that answer to psi
    Array<double> reach, driven, answering;
    Array<double> forces;               // (ports): of the last step found
    Array<double> stiff;                // (strings, width)
    Array<double> matrix, upper, over;  // of the equations of the means, factors (dense.hpp)
    Array<double> linear, y;            // in parts: (f_width); (two-way ports), zero but for those of these strings
    // of nonlinear connections: gap per mean psi of each string (k, strings padded);
    // the same of the active laws, solved (strings, laws padded); displacement of a
    // gap per displacement of a port (k, width), known if has_meets; gaps per force (k, k)
    std::vector<char> has_meets;
    Array<double> gap, solved, meets, z, row;
};

}  // namespace tonewood
