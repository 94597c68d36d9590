// The state that a run moves, its buffers, and the job. Nothing is allocated while stepping.
#pragma once

#include "laws.hpp"
#include "layout.hpp"
#include "potentials.hpp"

namespace tonewood {

constexpr int kStride = 2 * kBlock + 8;  // of a contact row's values: samples 0 .. kBlock, and room beyond the block

// Branch of a friction curve during a step: undecided, sticking, sliding either way, at a given velocity.
enum class Branch : char { open, stuck, ahead, behind, held };

// Nonlinear connections during a run.
struct ContactState {
    // by connection (k): compressions before the step, and after it without laws; forces; velocities of friction;
    // drives; size of the gap; highest offset in the block; clearance
    Array<double> old_p, free_p, law_force, last_force, slip, slip_after, offset, offset_after, velocity, scale, size,
        highest_offset, clearance;
    // of friction (k): its branch; velocity it is held at; velocity without it; velocity that a coefficient of 1 takes
    std::vector<Branch> branch;
    Array<double> held, without, load;
    std::vector<char> candidate, is_active, acted;  // acted: in this run
    std::vector<int> candidates, active, previous;
    // of residual compliances: displacements before and after a step, by place; by group, whether it moves
    Array<double> series, series_after;
    std::vector<char> series_moves;
    bool any_series = false;
    Array<double> least_clearance;   // by group: of contacts culled when the block began
    // by component: norm of the state when the block began; the part that known forces add to it
    Array<double> norm, added;
    Array<double> tension_excursion, tension_sensitivity;  // (., kBlock) psi_m sqrt(sum g^2 / a) at most; share per it
    std::vector<char> has_amplitudes;
    Array<double> amplitudes;        // of modes
    std::vector<std::vector<int>> rows_read, loaded;  // contact ports read, and loaded, in this block
    // by contact port
    Array<double> value;             // (n_contact, kStride): free motion, then the motion
    Array<double> force;             // (n_contact, kBlock)
    std::vector<char> row_is_read, is_loaded;
    std::vector<Array<double>> sensitivity;  // by component, over all its ports, fixed ones first: share per newton
    // by group: share of the tightest clearance taken before and after a sample, no contact below 1; contacts culled;
    // all culled by one bound; a control moves one of its contacts
    Array<double> share, share_after;
    std::vector<int> n_culled;
    std::vector<char> all_culled, driven;
    Array<double> port_sensitivity, port_share;  // (force_width): per newton; share that a port's forces took so far
    // of the solve. Of connections that acted since the model changed: gaps per force with the linear connections
    // answering (k, k), a column each, and the linear forces of that answer (k, f_width)
    std::vector<char> has_response;
    Array<double> z, answer;
    std::vector<int> stored, sliding;
    Array<double> x[12], matrix, f0;
    std::vector<int> gathered;             // connections whose compliances at rest stand in matrix
    Array<double> lower, upper, over;      // factors of a symmetric matrix, one over their diagonal
};

// Tables of the laws solved with the linear connections (connect/linear_laws.hpp).
struct LinearLaws {
    bool known = false;                     // derived for these laws and factors on them
    std::vector<int> laws;                  // connections
    Array<double> scale;
    std::vector<Entry> shared;              // (connections, laws): share of a law in the force read off a port
    PortForces forces;                      // of the laws in place of ports
    Array<double> memory;                   // (n, forces.width): the same per displacement of a residual compliance
    Array<double> loads;                    // (n, force_width): port forces per force, the linear connections answering
    // (ports, forces.width); as that of Potentials: per displacement of a port of Potentials
    Array<double> onto_laws, onto_ports;
};

struct Statistics {
    std::int64_t solves = 0, iterations = 0, most_iterations = 0, failures = 0;
    std::int64_t blocks = 0, rows_read = 0, added = 0;
};

// Values in place of a law's constants during a run: offset before and after each step, velocity, scale.
struct Control {
    int connection;        // among the nonlinear ones
    const double* values;  // (4, n)
};

// A known force on one component during a run.
struct Injection {
    int slot;
    std::int64_t first;  // step of the run it starts in (may be negative)
    std::int64_t length;
    int n_vectors;
    const double* vectors;  // (n_vectors, 2, n)
    const double* values;   // (n_vectors, length)
};

// One known input to a component's modes: `vector` (2, n) is added values[b * stride] times in sample b of the block.
struct Input {
    const double* vector;
    const double* values;
    int stride = 1;
};

struct Job {
    double* modes[2];  // the two numbers of every mode
    std::int64_t n = 0;
    double* out;       // (n, n_channels)
    double* forces;    // (n, m)
    int n_channels = 0;
    std::vector<Injection> injections;
    // of nonlinear connections
    double* law_forces;  // (n, k), zero beforehand
    double *series, *slip, *last_force;  // (k), moved
    std::vector<Control> controls;
    double* potentials = nullptr;  // numbers of all potentials, moved
    int phase = 0;  // samples since the last multiple of kResetSteps; with potentials and above 0, n ends at the next one
};

// Where a run had to stop: a component that is no longer finite, or connections whose forces were not found.
struct Fault {
    static constexpr int kNone = -1, kUnsolved = -2;
    int slot = kNone;
    std::int64_t sample = 0;
};

// All that is loaded; a run changes nothing of it.
struct Model {
    std::vector<Component> components;
    Layout layout;
    Solve solve;
    Nonlinear nonlinear;
    Potentials potentials;
    Shortcuts shortcuts;
};

// Buffers of runs, and tables that they derive when first needed. What moves is in the job's state.
struct Workspace {
    std::vector<Array<double>> recurrences;  // by component: numbers of its PortRecurrence, two of which move
    ContactState contacts;
    LinearLaws linear_laws;
    PotentialState potentials;
    Statistics statistics;
};

// Entry points of one instruction set's translation unit.
struct Table {
    const char* name;
    Fault (*run)(const Model&, Workspace&, const Job&);
    double (*fma_peak)(double seconds);  // measured multiply-adds per second
};

}  // namespace tonewood
