// A compiled system as it is loaded: plain arrays by name. No Python, no ownership: `load` copies the arrays it keeps.
//
// The arrays are those of tonewood.physics.stepping.kernel.describe, which saves and documents them.
#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../data/laws.hpp"
#include "../data/potentials.hpp"

namespace tonewood {

// A C-contiguous array of doubles.
struct View {
    const double* data = nullptr;
    int ndim = 0;
    std::array<std::size_t, 4> shape{};

    View() = default;
    View(const double* values, std::initializer_list<std::size_t> lengths) : data(values), ndim(int(lengths.size())) {
        std::copy(lengths.begin(), lengths.end(), shape.begin());
    }
    std::size_t size() const {
        std::size_t n = 1;
        for (int i = 0; i < ndim; ++i) n *= shape[i];
        return n;
    }
    double operator[](std::size_t i) const { return data[i]; }
    Array<double> copy() const { return Array<double>(data, data + size()); }
    bool equals(const Array<double>& a) const { return a.size() == size() && std::equal(a.begin(), a.end(), data); }
};

// Ports of a component on which only contacts act.
struct ContactPortsDescription {
    View rows, w;        // (n, 2, modes)
    View from_fixed;     // (kBlock, fixed ports, n): response k steps after a force on a fixed port
    View from_contact;   // (kBlock, n, n): after a force on a contact port
    View on_rows;        // (kBlock, n, rows): response of the component's rows to the contact ports
};

// Coordinates of a component on which a potential acts.
struct CoordinatesDescription {
    View reading, stiffness;  // (modes)
    View kick, middle;        // (2, modes)
    View velocity;            // (3, modes)
    View a;                   // (modes) weights of the stretch under rising tension, else zero
};

struct ComponentDescription {
    std::int64_t key = 0;   // equal keys, equal contents: a cached component needs no arrays
    bool cached = false;
    std::size_t offset = 0;
    bool driven = false;
    View e;                 // (4, modes)
    View rows;              // (rows, 2, modes)
    View w;                 // (ports, 2, modes)
    View response;          // (kBlock, ports, rows)
    View incidence;         // (linear connections, ports); without the last ones if these do not act here
    std::vector<int> channels, difference;  // by readout row
    bool has_contact_ports = false, has_coordinates = false;
    ContactPortsDescription contact;
    CoordinatesDescription coordinates;
};

struct LinearDescription {
    View inverse;    // (m, m), or
    struct Part {
        View places, inverses;  // (b, n), (b, n, n) of b parts of n connections
    };
    std::vector<Part> parts;
    struct Hub {
        int slot = -1;
        std::vector<int> ports, point;  // (r), (m)
        View factor, span, joined;      // (m), (points, r), (r, r)
    } hub;
    View gamma;      // (m)
    View constant;   // (m)
    View weights;    // (channels, m)
};

struct NonlinearDescription {
    double dt = 0, theta = 0.5;
    std::vector<Nonlinear::Term> terms;
    std::vector<Law> laws;     // (k)
    View weights;              // (channels, k)
    View compliance;           // (k, k)
    View from_linear;          // (k, m)
    View to_linear;            // (m, k)
    View residual;             // (k, k)
};

// A potential; its arrays are those of its kind.
struct PotentialDescription {
    struct Part {
        View slopes;             // longitudinal: (cosines, n)
        View weights, mirrored;  // phantom: (order + 1, n), (order + 1, order)
    };
    Potentials::Kind kind = Potentials::tension;
    std::size_t at = 0;          // of its numbers in the state
    std::vector<int> slots;      // its components; longitudinal: the longitudinal one last
    double scale = 0;            // EA/(4 L), EA L, EA
    std::vector<Part> parts;     // by component
    int target = 0;              // phantom: component that its force acts on, and
    View vector, steps;          // (2, modes of the target), (order, 6)
    std::vector<int> sizes;      // user: coordinates of each component, and a function; its C is `scale`
    UserPotential::Function function = nullptr;
    const void* data = nullptr;
    std::size_t scratch = 0;
};

struct CompiledSystem {
    std::vector<ComponentDescription> components;
    LinearDescription linear;
    NonlinearDescription nonlinear;
    std::vector<PotentialDescription> potentials;
    Shortcuts shortcuts;
};

// Refuses an array of another shape by its name.
inline void expect(const std::string& name, const View& a, std::initializer_list<std::size_t> shape) {
    bool same = a.ndim == int(shape.size());
    for (int i = 0; same && i < a.ndim; ++i) same = a.shape[i] == shape.begin()[i];
    if (same) return;
    const auto text = [](const auto begin, std::size_t n) {
        std::string out = "(";
        for (std::size_t i = 0; i < n; ++i) out += std::to_string(begin[i]) + (n == 1 || i + 1 < n ? "," : "");
        return out + ")";
    };
    throw std::invalid_argument("kernel: " + name + " has the shape " + text(a.shape.begin(), std::size_t(a.ndim)) +
                                ", not " + text(shape.begin(), shape.size()));
}
inline void require(bool fits, const std::string& message) {
    if (!fits) throw std::invalid_argument("kernel: " + message);
}

inline Law::Kind law_kind(std::int64_t kind) {
    require(kind >= Law::contact && kind <= Law::friction,
            "nonlinear.kinds: no law has the number " + std::to_string(kind));
    return Law::Kind(kind);
}

}  // namespace tonewood
