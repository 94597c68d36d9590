// Linear connections, and where the rows and ports of all components lie while a block is stepped.
#pragma once

#include "component.hpp"

namespace tonewood {

struct Entry {  // of a sparse matrix
    int row, column;
    double value;
    bool operator==(const Entry&) const = default;
};

// A sparse matrix of about as many entries in every row: layer l has the l-th entry of each. `rest` has the other
// entries of rows with more than kLayers.
struct SparseRows {
    struct Layer {
        std::vector<int> column;  // by row; 0 where the value is
        Array<double> value;
        bool in_order = true;     // row i has column i + shift, or no entry
        int shift = 0;
        int first = 0, end = 0;   // multiples of kLane: rows outside have no entry
    };
    static constexpr int kLayers = 8;
    int width = 0;  // rows, padded
    std::vector<Layer> layers;
    std::vector<Entry> rest;
};

// The linear connections solved in parts (connect/parts.hpp).
struct Parts {
    int m = 0, r = 0, points = 0;      // connections, motions and points of the hub
    int r_width = 0, point_width = 0;  // padded
    SparseRows gaps;              // (connections, two-way ports): displacement of a gap, without the hub
    SparseRows forces;            // (all ports, connections): the same for forces
    SparseRows blocks;            // (connections, connections) B
    SparseRows reach, load;       // (connections, points) B Q; (points, connections) its transpose
    SparseRows onto_points;       // (points, connections) Q^T
    Array<double> gamma;          // by connection
    double hub_gamma = 0;         // the largest of those with the hub
    SparseRows old;               // (connections, motions): gap per old motion where gamma is smaller
    std::vector<int> rows, to;    // (r) places of the motions' ports among two-way ports, and among all
    Array<double> joined, constant;    // (r, r_width) K^T; (r) U^T constant
    // where every point is a motion, P = 1, H = U^T B U is as sparse as B; otherwise
    bool own_motions = false;
    SparseRows own_stiffness;
    Array<double> span, motion, stiffness;  // (points, r_width) P; (r, point_width) P^T; (r, r_width) H
};

// f = constant - G (g_free + gamma g): forces of the linear connections from their gaps.
struct Solve {
    int m = 0;               // connections
    Array<double> g;         // (m, m); empty where it is given in parts
    Array<double> gamma;     // (m)
    Array<double> constant;  // (m)
    Array<double> weights;   // (n_channels, m) of forces in the readouts
    // G in parts (physics/coupling/inverse.py): B - B U K U^T B, B block-diagonal, U = Q P the motions of a hub at its points
    struct Hub {
        int slot = -1;               // component
        std::vector<int> ports;      // (r) its ports whose displacements are the motions
        std::vector<int> point;      // (m) point in each connection's gap, -1 without the hub
        Array<double> factor;        // (m) share of that point
        Array<double> span, joined;  // (points, r) P; (r, r) K
        bool operator==(const Hub&) const = default;
    };
    bool in_parts = false;
    std::vector<Entry> blocks;       // B
    Hub hub;
};

// Port forces = constant + free^T (y_free(b + 1) + mix y(b)) + old^T y(b), y the displacements of two-way ports.
struct PortForces {
    int width = 0;
    double mix = 0;
    Array<double> constant, free, old;  // (width), (port_rows, width) twice; `old` is empty if it is zero
    std::vector<int> rows;              // of `free` that are not zero
};

// The row history of a block is (kBlock + 1, width): one line of numbers per sample. Components of one port and one row
// stand first, side by side, so that one vector serves several, then those of two ports and two rows; every other
// component begins at a multiple of kLane.
// The port forces stand side by side in the same order. The connections are folded into two matrices: f = constant +
// gather^T (y(b), y_free(b + 1)), port forces = scatter^T f.
struct Layout {
    struct Alike {       // components of as many rows as ports, one or two, side by side
        int row = 0, force = 0, width = 0;  // the first one's row and port; rows, padded
        Array<double> response;             // (kBlock, ports, width): of each row to a port of its own component
    };
    struct Several {     // a component of several ports
        int row, force, n_ports, width;
        bool stepped;            // sample by sample: only the response of the next line is needed
        Array<double> response;  // (kBlock, n_ports, width)
    };
    int width = 0;                         // of a line
    int f_width = 0, force_width = 0;      // connections and ports, padded to kLane
    std::vector<int> row, port;            // first row and first port of each component
    std::vector<char> stepped;             // by component: stepped sample by sample (modal/shape_step.hpp)
    std::vector<int> sample_by_sample;     // these
    std::vector<char> by_itself;           // by component: no linear connection joins it to another one
    std::vector<int> port_rows;            // row of every two-way port
    Alike singles, pairs;
    std::vector<Several> several;
    std::vector<Array<double>> driven_response;  // by component: (n_ports, n_rows, 2 kBlock), the first half zero
    Array<double> constant;                // (f_width)
    Array<double> gather;                  // (2 port_rows, f_width)
    Array<double> scatter;                 // (m, force_width)
    PortForces direct;                     // both products in one
    struct Segment {
        int row, port, n;  // n ports, the first one at a row of the line
    };
    std::vector<Segment> segments;
    // a connection's force is that of a port on which it alone acts, times own_factor; empty if a connection has none
    std::vector<int> own_port;                          // (m)
    Array<double> own_factor;                           // (m)
    bool own_in_order = false;                          // connection j has port j
    bool in_parts = false;                              // `parts` stand for gather, scatter, direct
    Parts parts;
    struct ReadForce {
        int channel, connection;
        double weight;
    };
    std::vector<ReadForce> read_forces;    // linear connections whose force is an output
};

}  // namespace tonewood
