// Nonlinear connections: their laws, the ports they act on, and the groups of contacts that share bounds.
#pragma once

#include "component.hpp"

namespace tonewood {

// One nonlinear law; its numbers are those of tonewood.physics.coupling.laws.
struct Law {
    enum Kind { contact, spring, sampled, compiled, friction };
    Kind kind = contact;
    double a[4] = {};  // contact: K, alpha. spring: k, k3, d. friction: N, static, dynamic, speed
    double loss = 0, damping = 0;
    double offset = 0, velocity = 0;
    std::vector<double> knots, coefficients;  // (n + 1), (n, 4)
    struct Function {
        double (*plain)(double) = nullptr;
        double (*with_data)(double, void*) = nullptr;
        void* data = nullptr;
        double operator()(double x) const { return plain ? plain(x) : with_data(x, data); }
        bool operator==(const Function&) const = default;
    } potential, slope;
    bool one_sided() const { return kind == contact; }       // pushes from a clearance on: may be culled
    bool has_potential() const { return kind != friction; }  // else solved on its branches
    bool operator==(const Law&) const = default;
};

constexpr double kCoarse = 0.8;    // share of the clearances up to which one bound culls a whole group

// Which approximation-free shortcuts a run takes; docs/kernel.md derives each one.
struct Shortcuts {
    bool fused_pass = true;        // modes in port-recurrence form: one pass moves and reads them
    bool direct_step = true;       // port forces in one product, contact-free samples without the general step
    bool block_culling = true;     // contacts are stepped only where a bound cannot exclude them
    bool group_bound = true;       // one bound for all contacts of a group first
    bool fine_bound = true;        // a second bound about the middle of the block
    bool at_rest = true;           // components at rest that nothing can move are not stepped
    bool linear_laws = true;       // laws with a linear force are solved with the linear connections
    bool operator==(const Shortcuts&) const = default;
};

// Nonlinear connections, the linear ones eliminated.
struct Nonlinear {
    struct Term {
        int connection, component, port;
        bool contact;  // `port` counts contact ports, else fixed ports
        double factor;
        bool operator==(const Term&) const = default;
    };
    struct Group {  // components joined by contacts on contact ports
        std::vector<int> components, contacts;
        // if `simple` (all terms on contact ports, all gaps open at rest): norm of component q times
        // coarse_sensitivity[q] bounds the share of a clearance that its free motion takes; `sensitivity` (per newton
        // on fixed ports) and `tension_sensitivity` hold when each clearance is (1 - kCoarse) of the gap at rest
        bool simple = false;
        Array<double> coarse_sensitivity, tension_sensitivity;
        std::vector<Array<double>> sensitivity;
    };
    int k = 0;
    double dt = 0;
    double theta = 0.5;         // of the residual compliance in series
    std::vector<Law> laws;
    Array<double> compliance;   // (k, k): gaps per force without the linear connections, with the series part
    Array<double> from_linear;  // (k, m): gaps per force of the linear connections
    Array<double> to_linear;    // (k, f_width): gaps of the linear connections per force
    Array<double> residual;     // (k, k)
    Array<double> weights;      // (n_channels, k) of forces in the readouts
    std::vector<Term> all_terms;
    // derived by load/contact_groups.hpp
    std::vector<int> read_forces;  // connections with a weight
    struct Shared {  // gaps that share residual compliance: places first .. first + n of the displacements
        int first = 0, n = 0, width = 0;  // width: n, padded
        Array<double> residual;  // (connections, width): displacement of each place per force
    };
    std::vector<Shared> shared;
    std::vector<int> series;       // (k): number of its group in `shared`, -1 without
    std::vector<int> place;        // (k): of its displacement; n_places, which stays 0, without
    int n_places = 0;
    std::vector<std::vector<Term>> terms, driven;  // by connection: on two-way components, on driven ones
    std::vector<char> contact;                     // by connection: may be culled
    std::vector<char> only_contact_ports;          // by connection: a contact whose terms are all on contact ports
    Array<double> gap;                             // by connection: gap at rest, the negative offset
    std::vector<int> group_of;                     // by component, -1 outside of groups
    std::vector<int> group_of_law;                 // by connection, likewise
    std::vector<Group> groups;
    std::vector<int> first;                        // by component: its first contact port among all
    int n_contact = 0;
};

}  // namespace tonewood
