// Strings under rising tension, and strings whose longitudinal motion is stepped.
#pragma once

#include "component.hpp"

namespace tonewood {

// Strings whose tension rises, and their share in the matrix of the linear connections.
struct Tensions {
    struct String {
        int index;  // of its tension in the state
        double kappa;
        std::vector<int> components;
    };
    struct Term {
        int connection, component, port;
        double factor;
    };
    std::vector<String> strings;
    std::vector<int> components;
    Array<double> matrix;    // (m, m): M of f = -M^-1 (g_free + gamma g - offset), without additional tension
    Array<double> offset;    // (m)
    std::vector<Term> terms; // of linear connections, two-way
};

constexpr int kTaylor = 8;                     // coefficients of a compliance in an interval of the tension
constexpr int kSharedSums = 5, kPortSums = 6;  // of a modal pass, by string and by port

// Fixed ports of the tension-modulated components, and how their compliances change with the tensions: Taylor
// polynomials about the lower end of the interval in which a tension lies.
//
// Every string has a lane, one of 1, 2, 4 or a multiple of kLane: port p of its component c is number
// (c most_ports + p) strings + string, pair k is number k strings + string. Numbers without a port (component -1) are
// zero. `width`, of matrices, is the number of ports padded to kLane.
struct TensionPorts {
    struct Port {
        int component, port, string;
        int line, force, place;  // of its displacement in a line, of its force among all ports', in `y` below
    };
    struct Pair {  // ports of one component, to <= from, which is number `component` of its string's
        int component, to, from;
        int pair, to_port, from_port;  // where the first string's stand among pairs and ports
    };
    int strings = 0, most_components = 0, most_ports = 0, width = 0, pair_width = 0;
    std::vector<Pair> pairs;           // pairs of a port with itself first
    std::vector<Port> ports;
    std::vector<int> real;             // ports with a component
    std::vector<int> first, string_of; // by component: its first port; its string
    // by string: EA/(4 L) and its inverse; largest relative change of a mode's stiffness per newton and its inverse;
    // ends of the tension's interval
    Array<double> kappa, over_kappa, most, over_most, low, high;
    Array<double> changes;             // (kTaylor, pair_width): compliances less those at rest
    Array<double> onto_forces;         // (ports, force_width): port forces per displacement of a port
    Array<double> onto_ports;          // (ports, width): forces on these ports alone
    Array<double> onto_linear;         // (ports, f_width): forces of linear connections
    // sums of a modal pass, (kSharedSums, strings) and (kPortSums, width)
    std::vector<std::size_t> own;      // by component: the first sum of its first port
    Array<double> lanes;               // the sums before their lanes are added
    Array<double> sums;
    // of a sample
    Array<double> alone, moved, force, next, residual, base, fixed;  // by port
    Array<double> change_at, slope_at, bend_at, change, slope;       // by pair
    Array<double> y, linear, fixed_part;
    Array<double> inverse;             // (ports, width)
    std::vector<int> pivots;
    // of laws that acted since the model changed: compression lost per displacement of a port, and forces on the ports
    // per force of a law, (k, width) each; compressions while the ports do not move (k)
    std::vector<char> has_response;
    Array<double> meets, law_ports, law_free, sum, law_forces;
    // of the active laws alone: (ports, wide) and (laws, width)
    std::vector<int> active;
    Array<double> active_meets, active_ports, active_free, active_force;
    // linear active laws as further linear connections: their forces per force at compressions at rest (laws, wide) and
    // per displacement of a port (ports, wide); `onto_ports` and `fixed` with them
    bool folded = false;
    Array<double> law_slope, given, answers, caught, onto_with_laws, fixed_with_laws;
};

struct TensionState {
    Array<double> u, y, compliances, moved;  // of modes; `moved` is y after the step
    Array<double> scaled;                    // of modes: modal/scaled_modes.hpp
    TensionPorts ports;
    // by string
    Array<double> stretch, past, tension, used, at, after, pushed, sharp, far, last_tension, last_excess;
    Array<double> means[3];  // of the last steps, the latest first
    Array<double> fixed, matrix, inverse, right, scale, solution, residual;
    std::vector<char> done;
    bool inverted = false;   // in this block
    struct Wire {
        int index, port;  // among linear connections, then active laws; among the ports in use
        double factor;
    };
    std::vector<std::vector<Wire>> wires;         // by component
    std::vector<std::vector<int>> active_ports;   // by component: contact ports of active laws
    Array<double> free, compliance;               // of one component's ports in use
    Array<double> all, called, z;                 // (m + k, m + k) of all gaps; (k, m) M^-1 Z_ln; (k, k)
};

// Strings whose longitudinal motion is stepped with the transverse one (connect/longitudinal.hpp).
struct Geometric {
    struct Part {  // one component's lowest n modes, those that take part
        int component = 0, n = 0, width = 0, cosines = 0, cosines_width = 0;  // widths are padded
        Array<double> slopes, back;         // (n, cosines_width), (cosines, width): slope's cosines per coordinate
        Array<double> reading, kick;        // (width): coordinate per first number; (2, width): state per modal force
        Array<double> compliances, stretch; // (width): coordinate per modal force; its own share of twice s_0
        Array<double> to_port, from_port;   // (n_ports, width): port per modal force, coordinate per port force
    };
    struct String {
        int order = 0;            // P
        double scale = 0;         // EA L
        bool along = true;        // false: no longitudinal part, s_0 is the sum of stretch times squares
        std::vector<Part> parts;  // the longitudinal one last
    };
    std::vector<String> strings;
};

}  // namespace tonewood
