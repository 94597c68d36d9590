// The arrays that a step reads, and the ones it moves. Owned by `Kernel`; laid out for the sweeps in sweep.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

namespace tonewood {

constexpr int kBlock = 16;    // samples stepped between two visits to a component's modes
constexpr int kSpan = 8;      // samples of a block whose forces reach farther lines together
constexpr int kPadding = 16;  // modes per component are a multiple of this

constexpr int kGranule = 32;  // modes that recur the same way

template <class T>
struct AlignedAllocator {
    using value_type = T;
    static constexpr std::align_val_t kAlign{64};
    AlignedAllocator() = default;
    template <class U>
    AlignedAllocator(const AlignedAllocator<U>&) {}
    T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), kAlign)); }
    void deallocate(T* p, std::size_t) { ::operator delete(p, kAlign); }
    template <class U>
    bool operator==(const AlignedAllocator<U>&) const { return true; }
};
template <class T>
using Array = std::vector<T, AlignedAllocator<T>>;

// One known input to a component's modes: `vector` (2, n) is added values[b * stride] times in sample b of the block.
struct Input {
    const double* vector;
    const double* values;
    int stride = 1;
};

// Ports that only contacts act on, kept apart: they are left out of a block while a bound says that nothing touches
// there (guard.hpp).
struct Guarded {
    int n = 0;
    Array<double> rows, slopes;  // (n, 2, n_modes), as in Component
    Array<double> w, w_slope;    // (n, 2, n_modes)
    Array<double> from_fixed;    // (n_ports, n, kBlock): response of these rows k steps after a port force
    Array<double> from_guarded;  // (n, n, kBlock): the same after a force on one of these ports
    Array<double> on_rows;       // (n, kBlock, n_rows): response of the component's other rows to them
    // bounds throughout a block
    Array<double> norm;          // (2, n_modes): weights of the squares of a mode's two numbers
    Array<double> size;          // (n_modes): weight of the second number in the size of a mode
    Array<double> middle;        // (n, 2, n_modes): rows in the middle of a block
    Array<double> spread;        // (n, n_modes): how far the block may move a row from there, per size of a mode
    std::vector<double> peak;    // (n): |row| <= peak sqrt(norm)
    // (n), of a stretched string: |row| in the rest of the block <= pulled * T/2 sqrt(sum a (y+ + y)^2)
    std::vector<double> pulled;
    // of a woven string of one port, if its modes are passive there (calm.hpp): weights (2, n_modes) of the squares of a
    // mode's two numbers in its energy; |row| <= lean |port| + swing sqrt(energy), (n) each
    Array<double> energy;
    std::vector<double> swing, lean;
    Array<double> reach;         // (all ports, all ports), fixed ones first: |row| per sum |force| over a block
};

// Modes that are read by one row each, kept in what it reads of them while no known force acts (weave.hpp), in chunks of
// kChunk modes: trace (or kappa), det, the two numbers that move, and two numbers per port.
constexpr int kWeave = 4;  // blocks from going in to coming out

constexpr int kChunk = 8;

struct Woven {
    struct Chunk {       // neighbouring modes of one row that recur the same way
        int first, count, row;
        bool slow;
    };
    static constexpr std::size_t door_step = 8 * kChunk;
    int n_ports = 0;
    std::size_t step = 0;       // numbers per chunk
    std::vector<Chunk> chunks;  // none where a mode cannot be told from what its row reads
    Array<double> data, doors;  // doors: (2, 2) from the modes' numbers, (2, 2) back
};

// A string's polarization whose tension rises with amplitude, in mass-normalised coordinates y.
constexpr int kMaxStretchedPorts = 32;
constexpr int kTautNumbers = 4, kTautState = 3;  // by mode, and another one for each port

struct Stretched {
    bool on = false;
    double most_half = 0;    // largest of half
    Array<double> a, half;   // (n): weights of S; w a / 2, w the displacement per modal force held over a step
    Array<double> reading;   // (n): y = reading * first number
    Array<double> kick;      // (2, n): state per modal force held over a step
    Array<double> gain;      // (2, n): state per sum of row * port force, row that of the port's displacement
    Array<double> taut, doors;  // taut.hpp
    Array<double> phi, c;    // (n_ports, n): port displacement per y, y per port force
    Array<double> guarded_phi, guarded_c;  // the same of guarded ports
};

// A share of a port in a gap: port force += factor * force[connection], gap += factor * port displacement.
struct Share {
    int connection;
    double factor;
};

struct Component {
    int n = 0;          // modes, padded
    int n_ports = 0;
    int n_rows = 0;          // displacement of the ports (not of a driven component), then readouts
    std::size_t offset = 0;  // of this component in the state
    bool driven = false;     // forces in, nothing back
    Array<double> e;         // (4, n): e00, e01, e10, e11
    Array<double> rows;      // (n_rows, 2, n)
    Array<double> w;         // (n_ports, 2, n)
    Array<double> history;   // (kBlock, n_ports, n_rows): response of each row k steps after a port force
    // for the recurrences of sweep.hpp, derived from the above
    Array<double> trace, det, kappa;  // (n): of E, and det(I - E)
    std::vector<char> slow;      // by granule of modes: recurs in differences
    Array<double> slopes;    // (n_rows, 2, n): rows (E - I)
    Array<double> w_slope;   // (n_ports, 2, n): (E - tr) w; of slow modes (I + E - tr) w
    Array<double> e_block;   // (4, n): E^kBlock
    std::vector<std::vector<Share>> shares;  // by port
    std::vector<int> channels;               // by readout row
    std::vector<char> difference;            // by readout row: (y+ - y) instead of y
    Guarded guarded;
    Stretched stretched;
    bool geometric = false;  // of a string whose longitudinal motion is stepped: sample by sample
    Woven woven;
};

// f = constant - G (g_free + gamma g), the forces of the connections from their gaps.
struct Solve {
    int m = 0;               // connections
    Array<double> g;         // (m, m)
    Array<double> gamma;     // (m)
    Array<double> constant;  // (m)
    Array<double> weights;   // (n_channels, m) of forces in the readouts
};

// Where the rows of all two-way components lie while a block is stepped: one line of `width` numbers per sample.
// Components of one port and one row come first, side by side, so that one vector serves several; every other one
// begins at a multiple of kLane. The forces of all ports stand side by side too, in the same order. What the connections do in between is folded into
// two small matrices: f = constant + pull^T (y(b), y_free(b + 1)), port forces = push^T f.
constexpr int kLane = 8;
constexpr int kStride = 2 * kBlock + 8;  // of a guarded row's values: samples 0 .. kBlock, and room beyond the block

struct Layout {
    struct Several {     // a component of several ports
        int row, force, n_ports, width;
        Array<double> history;  // (kBlock, n_ports, width)
    };
    int width = 0, single_width = 0;       // of a line; of the first components in it
    int f_width = 0, force_width = 0;      // connections and ports, padded to kLane
    std::vector<int> row, port;            // first row and first port of each component
    std::vector<int> port_rows;            // row of every two-way port
    Array<double> single_history;          // (kBlock, single_width)
    std::vector<Several> several;
    std::vector<Array<double>> driven_history;  // by component: (n_ports, n_rows, 2 kBlock), the first half zero
    Array<double> constant;                // (f_width)
    Array<double> pull;                    // (2 port_rows, f_width)
    Array<double> push;                    // (m, force_width)
    // the same at once: port forces = direct_constant + direct^T (y_free(b + 1) + mix y(b)) + direct_old^T y(b), the
    // last for connections that count what was before otherwise than by mix; a connection's force is then that of a
    // port which it alone acts on (none if one of them has no such port)
    struct Segment {
        int row, port, n;  // n ports, the first one at a row of the line
    };
    std::vector<Segment> segments;
    double mix = 0.0;
    Array<double> direct_constant, direct, direct_old;  // (force_width), (port_rows, force_width) twice
    std::vector<int> own_port;                          // (m)
    Array<double> own_factor;                           // (m)
    bool own_in_order = false;                          // connection j has port j
    struct Heard {
        int channel, connection;
        double weight;
    };
    std::vector<Heard> heard;              // linear connections whose force is read
};

// One nonlinear law; its numbers are those of tonewood.coupling.laws.
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
    } potential, slope;
};

constexpr double kSway = 0.05;  // share of the clearances left to the motion of ports where energies bound the rest
constexpr double kQuiet = 0.8;  // share of the clearances up to which contacts are bounded together

// Nonlinear connections, as the linear ones leave their gaps.
struct Nonlinear {
    struct Term {
        int connection, component, port;
        bool guarded;
        double factor;
    };
    struct Group {  // of components that contacts on guarded ports join
        std::vector<int> components, contacts;
        // where all contacts are on guarded ports and have room below: the norms of the components times `tightest` add
        // up to the largest share of a clearance that free motion can take; `worth` of their fixed ports and
        // `pull_worth` of the rising tension when every slack is what kQuiet leaves of it
        bool simple = false;
        Array<double> tightest, pull_worth;
        std::vector<Array<double>> worth;
        // whether energies may bound it for a whole window; by component, share of the tightest clearance per square
        // root of energy, and how far its port may be for that (calm.hpp)
        bool calm = false;
        Array<double> strain, sway;
    };
    int k = 0;
    double dt = 0;
    double theta = 0.5;         // of the residual compliance in series
    bool asleep_allowed = true; // use the bounds of guard.hpp
    std::vector<Law> laws;
    Array<double> compliance;   // (k, k): gaps per force, linear connections left out, with the series part
    Array<double> from_linear;  // (k, m): gaps per force of the linear connections
    Array<double> to_linear;    // (k, f_width): gaps of the linear connections per force
    Array<double> residual;     // (k, k)
    Array<double> weights;      // (n_channels, k) of forces in the readouts
    std::vector<int> heard;     // connections with a weight
    std::vector<int> series;    // (k): which group of gaps shares residual compliance, -1 without
    int n_series = 0;
    std::vector<std::vector<int>> in_series;  // by group of these: its connections
    std::vector<Term> all_terms;
    // made by prepare.hpp
    std::vector<std::vector<Term>> terms, driven;  // by connection: two-way ones, one-way ones
    std::vector<char> guarded;                     // by connection: whether it may sleep
    std::vector<int> group_of;                     // by component, -1 outside of groups
    std::vector<int> group_of_law;                 // likewise by connection
    Array<double> worth;  // (force_width): if all groups are simple, `worth` of the port times the ports in its group
    std::vector<Group> groups;
    std::vector<int> first;                        // by component: its first guarded port among all
    int n_guarded = 0;
};

// Where on its curve friction is during a step: to be seen, sticking, sliding either way, at a velocity given.
enum class Branch : char { open, stuck, ahead, behind, held };

constexpr int kMostLinear = 16;  // laws, if all are linear, whose inverse is kept

// What a run with nonlinear connections moves besides, and its buffers: nothing is allocated while stepping.
struct Workspace {
    // by connection (k)
    Array<double> old_p, free_p, law_force, last_force, series, series_after, slip, slip_after, offset, offset_after,
        velocity, scale, size, clearance, slack, rest_p;
    // of friction (k): its branch; relative velocity it is held at; velocity without it; what a coefficient of 1 takes
    std::vector<Branch> branch;
    Array<double> held, without, load;
    std::vector<char> awake, touching, acted;  // acted: in this run
    std::vector<int> awake_list, active, previous;
    std::vector<char> series_alive;  // by series group
    bool any_alive = false;
    Array<double> least_slack;       // by group: of contacts that slept when the block began
    // by component
    Array<double> norm, added;       // of the state at the block's beginning; of what known forces add in it
    Array<double> pull, pull_worth;  // (., kBlock) T/2 sqrt(sum a (y+ + y)^2) at most; share of the tightest slack per it
    std::vector<char> sized;
    Array<double> sizes;             // of modes
    std::vector<std::vector<int>> awake_rows, loaded;  // guarded ports read, and pushed, in this block
    // by guarded port
    Array<double> value;             // (n_guarded, kStride): free motion, then the motion
    Array<double> force;             // (n_guarded, kBlock)
    std::vector<char> row_awake, is_loaded;
    // by component, over all its ports, fixed ones first
    std::vector<Array<double>> worth;  // share of the tightest slack per newton
    Array<double> level, level_after;  // by group: sum of worth |F| before and after a sample; nothing touches below 1
    std::vector<int> asleep;         // by group
    std::vector<char> quiet;         // by group: all asleep by one bound
    std::vector<char> driven;        // by group: a control moves one of its contacts
    Array<double> taken;             // (force_width): share of the tightest slack that a port's forces took in this block
    // of the solve. Of connections that acted since the model changed: gaps per force, the linear ones answering (k, k),
    // a column each, and the linear forces that they call up (k, f_width)
    std::vector<char> known;
    Array<double> z, answer;
    std::vector<int> stored, sliding;
    Array<double> x[12], matrix, f0;
    std::vector<int> gathered;       // connections whose compliances at rest stand in matrix
    Array<double> lower, upper, over;  // factors of a symmetric matrix, one over their diagonal
    bool factored = false;           // the inverse is that for linear laws of the slopes in x[2]
    Array<double> inverse;
};

struct Statistics {
    std::int64_t solves = 0, iterations = 0, most_iterations = 0, failures = 0;
    std::int64_t blocks = 0, rows_read = 0, woken = 0, windows = 0, calm = 0;
    std::int64_t tension_iterations = 0, most_tension_iterations = 0;
};

// The strings whose tension rises, and what they need of the linear connections.
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
    struct Pair {  // a share of a stretched component's port compliance in the matrix
        int component, place, row, column;
        double factor, rest;  // rest: the compliance without additional tension
    };
    std::vector<String> strings;
    std::vector<int> components;
    Array<double> matrix;    // (m, m): M of f = -M^-1 (g_free + gamma g - offset), without additional tension
    Array<double> offset;    // (m)
    std::vector<Term> terms; // of linear connections, two-way
    std::vector<Pair> pairs;
};

// The fixed ports of stretched components, and how their compliances change with the tensions: as Taylor's polynomials
// about the beginning of the cell that a tension lies in, which tells all of them.
constexpr int kTaylor = 8;
constexpr int kSharedSums = 5, kPortSums = 6;  // of a pass over modes, by string and by port

struct TensePorts {
    struct Port {
        int component, port, string;
        int line, force, place;  // of its displacement in a line, of its force among all ports', in `y` below
    };
    struct Pair {  // ports of one component, to <= from, which is number `component` of its string's
        int component, to, from;
        int pair, to_port, from_port;  // where the first string's stand among pairs and ports
    };
    // Every string has a lane, one of 1, 2, 4 or a multiple of kLane: port p of its component c is number
    // (c most_ports + p) strings + string, pair k number k strings + string. What there is none of is empty
    // (component -1), all its numbers zero. `width` is that of matrices, the number of ports padded to kLane.
    int strings = 0, most_components = 0, most_ports = 0, width = 0, pair_width = 0;
    std::vector<Pair> pairs;           // those of a port with itself first
    std::vector<Port> ports;
    std::vector<int> real;             // those that are not empty
    std::vector<int> first, string_of; // by component: its first port; its string
    // by string: EA/(4 L) and its inverse; largest relative change of a mode's stiffness per newton and its inverse;
    // tensions that its cell reaches from and to
    Array<double> kappa, over_kappa, most, over_most, low, high;
    Array<double> changes;             // (kTaylor, pair_width): compliances less those at rest
    Array<double> onto_forces;         // (ports, force_width): port forces per displacement of a port by itself
    Array<double> onto_ports;          // (ports, width): forces on these ports alone
    Array<double> onto_linear;         // (ports, f_width): the same for forces of linear connections
    // sums of a visit, (kSharedSums, strings) and (kPortSums, width)
    std::vector<std::size_t> own;      // by component: the first one of its first port
    Array<double> lanes;               // of the sums
    Array<double> sums;
    // of a sample
    Array<double> alone, moved, force, next, wrong, base, fixed;  // by port
    Array<double> change_at, slope_at, bend_at, change, slope;  // by pair
    Array<double> y, linear, fixed_part;
    Array<double> inverse;             // (ports, ports)
    std::vector<int> pivots;
    // of laws that acted since the model changed: compression lost per displacement of a port by itself, and forces on
    // the ports per force of a law, (k, width) each; compressions while the ports do not move by themselves (k)
    std::vector<char> known;
    Array<double> meets, law_ports, law_free, sum, law_forces;
    // the same of the laws that act alone: (ports, wide) and (laws, width)
    std::vector<int> active;
    Array<double> active_meets, active_ports, active_free, active_force;
    // where these are linear, as further linear connections: their forces per force at compressions at rest (laws, wide)
    // and per displacement of a port (ports, wide), lost; `onto_ports` and `fixed` with them
    bool folded = false;
    Array<double> law_slope, given, answers, caught, onto_with_laws, fixed_with_laws;
};

struct TensionSpace {
    Array<double> u, y, yields;  // of modes
    Array<double> taut;      // of modes: taut.hpp
    TensePorts ports;
    // by string
    Array<double> stretch, past, tension, used, at, after, pushed, sharp, far, last_tension, last_excess;
    Array<double> means[3];  // of the last steps, the latest first
    Array<double> fixed, matrix, inverse, right, scale, solution, wrong;
    std::vector<char> done;
    bool inverted = false;   // in this block
    // with nonlinear connections
    struct Wire {
        int index, port;  // among linear connections, then active ones; among the ports in use
        double factor;
    };
    Array<double> moved;     // y after the step, of modes
    std::vector<std::vector<Wire>> wires;         // by component
    std::vector<std::vector<int>> active_ports;   // by component: guarded ports of active contacts
    Array<double> free, compliance;               // of one component's ports in use
    Array<double> all, called, z;                 // (m + k, m + k) of all gaps; (k, m) M^-1 Z_ln; (k, k)
};

// Strings whose longitudinal motion is stepped with the transverse one (geometric.hpp).
struct Geometric {
    struct Part {  // one component's lowest n modes, those that take part
        int component = 0, n = 0, width = 0, cosines = 0, cosines_width = 0;  // widths are padded
        Array<double> slopes, back;         // (n, cosines_width), (cosines, width): slope's cosines per coordinate
        Array<double> reading, kick;        // (width): coordinate per first number; (2, width): state per modal force
        Array<double> yields, stretch;      // (width): coordinate per modal force; its own share of twice s_0
        Array<double> to_port, from_port;   // (n_ports, width): port per modal force, coordinate per port force
    };
    struct String {
        int order = 0;     // P
        double scale = 0;  // EA L
        bool along = true;        // false: it has no longitudinal part, and s_0 is the sum of stretch times squares
        std::vector<Part> parts;  // the longitudinal one last
    };
    std::vector<String> strings;
};

// What stands in for a law's constants during a run: offset before and after each step, velocity, scale.
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
    const double* values;  // (n_vectors, length)
};

struct Job {
    double* modes[2];  // the two numbers of every mode
    std::int64_t n;
    double* out;     // (n, n_channels)
    double* forces;  // (n, m)
    int n_channels;
    const Injection* injections;
    int n_injections;
    // of nonlinear connections
    double* law_forces;  // (n, k), zero beforehand
    double *series, *slip, *last_force;  // (k), moved
    const Control* controls;
    int n_controls;
    double* tension;  // (n_tensions, 3), moved
};

// Where a run had to stop: a component that is no longer finite, or connections whose forces were not found.
struct Fault {
    static constexpr int kNone = -1, kUnsolved = -2;
    int slot = kNone;
    std::int64_t sample = 0;
};

using Run = Fault (*)(std::vector<Component>&, const Layout&, const Solve&, const Nonlinear&, const Tensions&,
                      const Geometric&, Workspace&, TensionSpace&, Statistics&, const Job&);

// Entry points of one instruction set's translation unit.
struct Table {
    const char* name;
    Run run;
    double (*fma_peak)(double seconds);  // measured multiply-adds per second
};

}  // namespace tonewood
