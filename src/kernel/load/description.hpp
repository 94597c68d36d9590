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
#include "../data/phantoms.hpp"

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

// A string's polarization under rising tension.
struct TensionDescription {
    View a, half, reading;  // (modes)
    View kick;              // (2, modes)
    View velocity;          // (3, modes)
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
    bool has_contact_ports = false, has_tension = false;
    ContactPortsDescription contact;
    TensionDescription tension;
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

struct StretchDescription {
    struct Part {
        int slot = 0;
        View slopes;     // (cosines, n), or the stretch (1, n) without longitudinal motion
        View stiffness;  // (n)
    };
    double scale = 0;
    bool longitudinal = false;
    std::vector<Part> parts;  // the longitudinal one last
};

struct TensionsDescription {
    struct String {
        int index;             // of its row in the state
        double kappa;
        std::vector<int> slots;
    };
    std::vector<String> strings;
    std::vector<StretchDescription> stretches;  // by string; none where no string has longitudinal motion
};

// A string whose longitudinal motion is driven one way.
struct PhantomDescription {
    struct Part {
        int slot = 0;
        View weights;   // (order + 1, n)
        View mirrored;  // (order + 1, order)
    };
    int index = 0, target = 0;
    double scale = 0;
    View vector;        // (2, modes of the target)
    View steps;         // (order, 4)
    std::vector<Part> parts;
};

struct CompiledSystem {
    std::vector<ComponentDescription> components;
    LinearDescription linear;
    NonlinearDescription nonlinear;
    TensionsDescription tensions;
    std::vector<PhantomDescription> phantoms;
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

}  // namespace tonewood
