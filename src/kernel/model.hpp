// The arrays that a step reads, and the ones it moves. Owned by `Kernel`; laid out for the sweeps in sweep.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <vector>

namespace tonewood {

constexpr int kBlock = 16;    // samples stepped between two visits to a component's modes
constexpr int kPadding = 32;  // modes per component are a multiple of this

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

// One known input to a component's modes: `vector` (2, n) is added `value[b]` times in sample b of the block.
template <class T>
struct Input {
    const T* vector;
    const double* values;
};

// A share of a port in a gap: port force += factor * force[connection], gap += factor * port displacement.
struct Share {
    int connection;
    double factor;
};

template <class T>
struct Component {
    int n = 0;          // modes, padded
    int n_ports = 0;    // rows [0, n_ports) are the displacement of the ports
    int n_rows = 0;     // further rows are readouts
    std::size_t offset = 0;  // of this component in the state
    bool driven = false;     // forces in, nothing back
    Array<T> e;              // (4, n): e00, e01, e10, e11
    Array<T> rows;           // (n_rows, 2, n)
    Array<T> w;              // (n_ports, 2, n)
    Array<double> history;   // (n_ports, n_rows, kBlock): response of each row k steps after a port force
    // for the recurrences of sweep.hpp, derived from the above in double precision
    Array<T> det, kappa;     // (n)
    Array<T> slopes;         // (n_rows, 2, n): rows (E - I)
    Array<T> w_slope;        // (n_ports, 2, n): (I + E - tr) w
    Array<T> e_block;        // (4, n): E^kBlock
    std::vector<std::vector<Share>> shares;  // by port
    std::vector<int> channels;               // by readout row
    std::vector<char> difference;            // by readout row: (y+ - y) instead of y
};

struct Solve {
    int m = 0, stride = 0;   // connections; the same padded to 8
    Array<double> g_t;       // (m, stride) transposed G
    Array<double> gamma;     // (m)
    Array<double> constant;  // (stride)
    Array<double> weights;  // (n_channels, m) of forces in the readouts
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
using Run = Fault (*)(const std::vector<Component<T>>&, const Solve&, const Job<T>&);

// Entry points of one instruction set's translation unit.
struct Table {
    const char* name;
    Run<double> run_f64;
    Run<float> run_f32;
    double (*fma_peak)(double seconds);  // measured multiply-adds per second, f64
};

}  // namespace tonewood
