// Components: modes, ports and readouts, with the tables that `load/` derives from them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

namespace tonewood {

constexpr int kBlock = 16;    // samples between two modal passes
constexpr int kWindow = 4;    // blocks after which every mode stands in its own two numbers again
constexpr int kResetSteps = 64;  // samples after which psi of a rising tension is put back (potentials/solve.hpp)
constexpr int kPadding = 16;  // modes per component are a multiple of this
constexpr int kGranule = 32;  // modes that use the same recurrence
constexpr int kLane = 8;      // rows and ports in `Layout` are padded to this

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

constexpr std::size_t padded(std::size_t n) { return (n + kLane - 1) / kLane * kLane; }

// Ports on which only contacts act. A block is stepped without them while a bound excludes contact (cull/).
struct ContactPorts {
    int n = 0;
    Array<double> rows, slopes;  // (n, 2, n_modes), as in Component
    Array<double> w, w_slope;    // (n, 2, n_modes)
    Array<double> from_fixed;    // (n_ports, n, kBlock): response of these rows k steps after a force on a fixed port
    Array<double> from_contact;  // (n, n, kBlock): the same after a force on a contact port
    Array<double> on_rows;       // (n, kBlock, n_rows): response of the component's other rows to these ports
    // bounds over a block (cull/row_bounds.hpp)
    Array<double> norm;          // (2, n_modes): weights of the squares of a mode's two numbers
    Array<double> size;          // (n_modes): weight of the second number in a mode's amplitude
    Array<double> middle;        // (n, 2, n_modes): rows in the middle of the block
    Array<double> spread;        // (n, n_modes): largest change of a row from there, per amplitude of a mode
    std::vector<double> peak;    // (n): |row| <= peak sqrt(norm)
    std::vector<double> tension_reach;  // (n): |row| moves by <= tension_reach * psi_m sqrt(sum g^2 / a)
    Array<double> reach;         // (all ports, all ports), fixed ones first: |row| per sum of |force| over a block
};

// The port-recurrence form (modal/fused_pass.hpp) of modes that are read by one row each: chunks of kChunk neighbouring
// modes of one row that use the same recurrence.
constexpr int kChunk = 8;

struct PortRecurrence {
    struct Chunk {
        int first, count, row;
        bool slow;
    };
    static constexpr std::size_t basis_step = 8 * kChunk;
    int n_ports = 0;
    std::size_t step = 0;       // numbers per chunk in `numbers`
    std::vector<Chunk> chunks;  // empty where a mode's state does not follow from the values of its row
    Array<double> numbers;      // per chunk: trace or kappa, det, the two moving numbers, two responses per port
    Array<double> basis;        // per chunk: (2, 2) from the modes' two numbers to the moving ones, (2, 2) back
};

// Ports of real modes (modal/shape_step.hpp): row of port p = phi_kp read, its state per force = phi_kp drive.
constexpr int kLeastShapes = 16;  // ports from which on it is quicker to step them sample by sample

struct Shapes {
    bool on = false;
    std::size_t width = 0;            // ports, padded
    Array<double> phi;                // (n, width)
    Array<double> read, read_next;    // (2, n), as a row of the component, and read E
    Array<double> drive;              // (2, n), as its `w`
};

// Mass-normalised coordinates y of real modes on which a potential acts (physics/coupling/potentials/coordinates.py).
constexpr int kMaxScaledPorts = 32;
// numbers per mode in `numbers` (one more per port) and in the state
constexpr int kScaledNumbers = 5, kScaledState = 2;

struct Coordinates {
    std::size_t n = 0;            // modes without the padding at the end
    Array<double> reading;        // (n): y = reading * first number of the mode
    Array<double> kick;           // (2, n): state per modal force held over a step
    Array<double> gain;           // (2, n): state per sum of row * port force, row that of the port's displacement
    Array<double> velocity;       // (3, n): y' per first and second number, second number per y'
    Array<double> stiffness;      // (n): square of the frequency
    Array<double> middle;         // (2, n): y in the middle of a step per sum of its ends, and per motion by port forces
    Array<double> numbers, basis; // modal/scaled_modes.hpp: tables of the pass; changes of basis
    // of strings under rising tension: (n) weights of the stretch S; w a / 2, w the displacement per modal force
    Array<double> a, half;
    double largest_half = 0, largest_first = 0;  // of half and p_0
};

// A port's share in a gap: port force += factor * force[connection], gap += factor * port displacement.
struct Share {
    int connection;
    double factor;
};

struct Component {
    int n = 0;          // modes, padded
    int n_ports = 0;
    int n_rows = 0;          // displacements of the ports (not of a driven component), then readouts
    std::size_t offset = 0;  // of this component in the state
    bool driven = false;     // receives forces and returns none
    // a potential acts on it: a rising tension; any other
    bool modulated = false, coupled = false;
    Array<double> e;         // (4, n): e00, e01, e10, e11 of x+ = E x
    Array<double> rows;      // (n_rows, 2, n)
    Array<double> w;         // (n_ports, 2, n): state per port force held over a step
    Array<double> response;  // (kBlock, n_ports, n_rows): response of each row k steps after a port force
    // derived for the recurrences of modal/pass.hpp
    Array<double> trace, det, kappa;  // (n): trace and determinant of E, det(I - E)
    std::vector<char> slow;           // by granule of modes: recurrence in differences
    Array<double> slopes;             // (n_rows, 2, n): rows (E - I)
    Array<double> ratio;              // (n): second of two rows over the first, where one number is; else empty
    Array<double> w_slope;            // (n_ports, 2, n): (E - tr) w; of slow modes (I + E - tr) w
    Array<double> e_block;            // (4, n): E^kBlock
    std::vector<std::vector<Share>> shares;  // by port
    std::vector<int> channels;               // by readout row
    std::vector<char> difference;            // by readout row: y+ - y instead of y
    PortRecurrence recurrence;
    Shapes shapes;
    ContactPorts contact;
    Coordinates coordinates;

    bool by_sample() const { return modulated || coupled; }  // its modes are stepped sample by sample
};

}  // namespace tonewood
