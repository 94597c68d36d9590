// Potentials of modal coordinates: those that act both ways, and longitudinal motion that is driven one way.
#pragma once

#include <array>

#include "component.hpp"

namespace tonewood {

constexpr std::size_t kColumns = 6 * kLane;  // of a block of a matrix (potentials/plane_products.hpp)
// Columns of the first block of `left`: about as many as of the others.
constexpr std::size_t block_columns(std::size_t left) {
    return padded((left + (left + kColumns - 1) / kColumns - 1) / ((left + kColumns - 1) / kColumns));
}

// A string with longitudinal motion (potentials/longitudinal.hpp).
struct Stretch {
    struct Planes {  // one or two polarizations, side by side and with the same shapes
        int first = 0, count = 1, n = 0, width = 0;  // components; lowest modes that take part; these, padded
        // (n, points padded) slope at each point per coordinate, (points, width) its transpose; by blocks of columns
        Array<double> slopes, pulls;
    };
    int order = 0;             // P
    int points = 0;            // theta = (j + 1/2) pi / points: sums over them are integrals
    int width_at_points = 0;   // these, padded
    double scale = 0;          // EA L
    std::vector<int> sizes;    // modes of each component that take part, the lowest; the longitudinal one last
    std::vector<Planes> planes;
    Array<double> project;     // (points, strain_width): s_n per squared slope at each point
    Array<double> spread;      // (P + 1, points padded): pull per slope there, of s_n + l_n; by blocks of columns
    int width = 0, strain_width = 0;  // modes of the longitudinal component, cosines of its strain; padded
    Array<double> weights;            // (strain_width): EA L g_n
    Array<double> strain, back;       // (modes, strain_width), (P + 1, width): strain's cosines per coordinate
};

// A string whose longitudinal motion is driven one way (potentials/phantom.hpp).
constexpr int kPhantomModes = 32;                            // longitudinal modes of a string at most
constexpr int kPhantomMemory = kBlock + 2 * kPhantomModes;   // numbers of a string in the state

struct PhantomString {
    struct Part {  // a polarization: its lowest n modes
        int slot = 0, n = 0;     // component; these modes
        Array<double> weights;   // (n, order + 1)
        Array<double> mirrored;  // (order + 1, kPhantomModes / 2)
        bool operator==(const Part&) const = default;
    };
    std::size_t at = 0;          // of its numbers in the state
    int target = 0;              // component that its force acts on
    int order = 0;               // longitudinal modes
    double scale = 0;            // EA
    Array<double> steps;         // (6, kPhantomModes)
    std::vector<Part> parts;
    bool operator==(const PhantomString&) const = default;
};

// Forces of such strings on a component: they add sum_j vectors_j sum_q shares_jq F_q to its state.
struct DrivenForces {
    int target = 0;
    std::size_t count = 0;       // vectors: as many as are independent, at most
    Array<double> vectors;       // (count, 2, n)
    Array<double> shares;        // (count, strings): 0 for those that act on another component
};

// A potential given as a C function (potentials/user.hpp).
struct UserPotential {
    using Function = double (*)(const void* data, std::int64_t n, const double* y, double* gradient, double* scratch);
    Function function = nullptr;
    const void* data = nullptr;
    std::size_t scratch = 0;   // numbers
    double shift = 0;          // C
    std::vector<int> sizes;    // coordinates of each component: its lowest modes
    int n() const {
        int sum = 0;
        for (const int size : sizes) sum += size;
        return sum;
    }
    double call(const double* y, double* gradient, double* scratch_) const {
        return function(data, n(), y, gradient, scratch_);
    }
};

// All potentials, and the tables that load/potentials.hpp derives of them.
struct Potentials {
    enum Kind { tension, longitudinal, phantom, user, n_kinds };
    struct Part {  // a component of a potential
        int component, potential, first_port;
        std::size_t sums;  // its sums of a modal pass among all
    };
    struct Port {      // a fixed port of such a component
        // of its displacement in a line, of its force among all ports', among two-way ports, in a row of `onto_ports`
        int potential, line, force, place, lane;
        std::vector<Share> shares;       // of the linear connections
    };
    struct One {
        Kind kind = tension;
        std::size_t at = 0;            // of its numbers in the state
        double scale = 0;              // of a tension: EA/(4 L)
        std::vector<int> components;
        int data = -1;                 // its own arrays: among `stretches` or `users`
        int first = 0, n = 0, first_part = 0;  // its ports; its parts, one for each component
        // of a tension
        Array<double> steady;           // (n) bounds on sqrt(sum g^2 / a) per force on a port
        double root = 0, highest = 0;   // 2 sqrt(kappa); largest w a / 2
        // (n, n) pairs of its ports: coefficients by powers of T of sum q p_1 r r and of sum (q p_1)^2 r r
        std::vector<std::array<double, 2>> once;
        std::vector<std::array<double, 3>> twice;
    };
    std::vector<One> two_way;           // those of a kind together, in the order of kinds
    std::vector<PhantomString> driven;
    std::vector<DrivenForces> driven_forces;  // by component that they act on
    std::vector<Stretch> stretches;
    std::vector<UserPotential> users;
    std::size_t memory = 0;             // numbers in the state, at least
    std::vector<Part> parts;            // potential by potential
    std::vector<Port> ports;            // part by part
    int width = 0;                      // ports, padded
    int lanes = 0, most = 0;            // potentials, padded; ports of one, at most
    std::size_t n_sums = 0;
    Array<double> onto_ports;           // (ports, most, lanes): forces on these ports per displacement of one
    // where the linear connections are one matrix: (ports, force_width) forces on all ports, (ports, f_width) of
    // connections
    Array<double> onto_forces, onto_linear;
    std::vector<int> answered;          // ports to which linear connections answer: their rows are not zero
};

constexpr int kSharedSums = 3, kPortSums = 5;  // of a modal pass over a component, and for each of its ports

struct PotentialState {
    Array<double> scaled;               // of modes: modal/scaled_modes.hpp
    Array<double> known;                // of modes: (p_1 - p_0) times what known forces add to v in the step
    Array<double> lanes, sums;          // of the modal passes, before and after their lanes are added
    // by potential: psi and its mean over the step, with and without nonlinear connections; g . w g; C
    Array<double> psi, mean, alone, own, shift;
    Array<double> spread, bound;        // of tensions: sizes of the direction (excursion)
    // (ports): displacement per mean psi; forces of the linear connections alone, and of those that answer to psi
    Array<double> reach, driven, answering;
    Array<double> pulled, answered;     // (ports): displacements by fast coordinates, forces with the answer to them
    Array<double> forces, moved;        // (ports): of the last step found; displacements by psi
    Array<double> reach_lanes;          // (most, lanes): as a row of Potentials::onto_ports
    Array<double> unit;                 // (2 lanes): a one in the middle
    Array<double> matrix, upper, over;  // of the equations of the means, factors (dense.hpp)
    Array<double> linear, y;            // in parts: (f_width); (two-way ports), zero but for those of these components
    // of nonlinear connections: gap per mean psi of each potential (k, potentials padded);
    // the same of the active laws, solved (potentials, laws padded); displacement of a
    // gap per displacement of a port (k, most, lanes), known if has_meets; gaps per force (k, k)
    std::vector<char> has_meets;
    Array<double> gap, solved, meets, z, row;
};

}  // namespace tonewood
