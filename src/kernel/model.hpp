// The arrays that a step reads, and the ones it moves. Owned by `Kernel`; laid out for the sweeps in sweep.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

namespace tonewood {

constexpr int kBlock = 16;    // samples stepped between two visits to a component's modes
constexpr int kPadding = 16;  // modes per component are a multiple of this

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
template <class T>
struct Input {
    const T* vector;
    const double* values;
    int stride = 1;
};

// A share of a port in a gap: port force += factor * force[connection], gap += factor * port displacement.
struct Share {
    int connection;
    double factor;
};

template <class T>
struct Component {
    int n = 0;          // modes, padded
    int n_ports = 0;
    int n_rows = 0;          // displacement of the ports (not of a driven component), then readouts
    std::size_t offset = 0;  // of this component in the state
    bool driven = false;     // forces in, nothing back
    Array<T> e;              // (4, n): e00, e01, e10, e11
    Array<T> rows;           // (n_rows, 2, n)
    Array<T> w;              // (n_ports, 2, n)
    Array<double> history;   // (kBlock, n_ports, n_rows): response of each row k steps after a port force
    // for the recurrences of sweep.hpp, derived from the above in double precision
    Array<T> turn, kappa;    // (n): tr E - 1 and det(I - E)
    Array<T> slopes;         // (n_rows, 2, n): rows (E - I)
    Array<T> w_slope;        // (n_ports, 2, n): (I + E - tr) w
    Array<T> e_block;        // (4, n): E^kBlock
    std::vector<std::vector<Share>> shares;  // by port
    std::vector<int> channels;               // by readout row
    std::vector<char> difference;            // by readout row: (y+ - y) instead of y
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
// Components of one port come first, side by side, so that one vector serves several; every other one begins at a
// multiple of kLane. The forces of all ports stand side by side too. What the connections do in between is folded into
// two small matrices: f = constant + pull^T (y_free(b + 1), y(b)), port forces = push^T f.
constexpr int kLane = 8;

struct Layout {
    struct Several {     // a component of several ports
        int row, force, n_ports, width;
        Array<double> history;  // (kBlock, n_ports, width)
    };
    int width = 0, single_width = 0;       // of a line; of the one-port components in it
    int f_width = 0, force_width = 0;      // connections and ports, padded to kLane
    std::vector<int> row, port;            // first row and first port of each component
    std::vector<int> port_rows;            // row of every two-way port
    std::vector<int> singles;              // port that each row of the one-port components answers to, or -1
    Array<double> single_history;          // (kBlock, single_width)
    std::vector<Several> several;
    std::vector<Array<double>> driven_history;  // by component: (n_ports, n_rows, 2 kBlock), the first half zero
    Array<double> constant;                // (f_width)
    Array<double> pull;                    // (2 port_rows, f_width)
    Array<double> push;                    // (m, force_width)
};

// A known force on one component during a run.
template <class T>
struct Injection {
    int slot;
    std::int64_t first;  // step of the run it starts in (may be negative)
    std::int64_t length;
    int n_vectors;
    const T* vectors;      // (n_vectors, 2, n)
    const double* values;  // (n_vectors, length)
};

template <class T>
struct Job {
    T* modes[2];  // the two numbers of every mode
    std::int64_t n;
    double* out;     // (n, n_channels)
    double* forces;  // (n, m)
    int n_channels;
    const Injection<T>* injections;
    int n_injections;
};

// Where the state stopped being finite; slot < 0 if it did not.
struct Fault {
    int slot = -1;
    std::int64_t sample = 0;
};

template <class T>
using Run = Fault (*)(const std::vector<Component<T>>&, const Layout&, const Solve&, const Job<T>&);

// Entry points of one instruction set's translation unit.
struct Table {
    const char* name;
    Run<double> run_f64;
    Run<float> run_f32;
    double (*fma_peak)(double seconds);  // measured multiply-adds per second, f64
};

}  // namespace tonewood
