// Linear connections, and where the rows and ports of all components lie while a block is stepped.
#pragma once

#include "component.hpp"

namespace tonewood {

// f = constant - G (g_free + gamma g): forces of the linear connections from their gaps.
struct Solve {
    int m = 0;               // connections
    Array<double> g;         // (m, m)
    Array<double> gamma;     // (m)
    Array<double> constant;  // (m)
    Array<double> weights;   // (n_channels, m) of forces in the readouts
};

// The row history of a block is (kBlock + 1, width): one line of numbers per sample. Components of one port and one row
// stand first, side by side, so that one vector serves several; every other component begins at a multiple of kLane. The
// port forces stand side by side in the same order. The connections are folded into two matrices:
// f = constant + gather^T (y(b), y_free(b + 1)), port forces = scatter^T f.
struct Layout {
    struct Several {     // a component of several ports
        int row, force, n_ports, width;
        Array<double> response;  // (kBlock, n_ports, width)
    };
    int width = 0, single_width = 0;       // of a line; of the components of one port and one row in it
    int f_width = 0, force_width = 0;      // connections and ports, padded to kLane
    std::vector<int> row, port;            // first row and first port of each component
    std::vector<int> port_rows;            // row of every two-way port
    Array<double> single_response;         // (kBlock, single_width)
    std::vector<Several> several;
    std::vector<Array<double>> driven_response;  // by component: (n_ports, n_rows, 2 kBlock), the first half zero
    Array<double> constant;                // (f_width)
    Array<double> gather;                  // (2 port_rows, f_width)
    Array<double> scatter;                 // (m, force_width)
    // both products in one: port forces = direct_constant + direct^T (y_free(b + 1) + mix y(b)) + direct_old^T y(b);
    // direct_old is empty if all connections have gamma = mix
    struct Segment {
        int row, port, n;  // n ports, the first one at a row of the line
    };
    std::vector<Segment> segments;
    double mix = 0.0;
    Array<double> direct_constant, direct, direct_old;  // (force_width), (port_rows, force_width) twice
    // a connection's force is that of a port on which it alone acts, times own_factor; empty if a connection has none
    std::vector<int> own_port;                          // (m)
    Array<double> own_factor;                           // (m)
    bool own_in_order = false;                          // connection j has port j
    struct ReadForce {
        int channel, connection;
        double weight;
    };
    std::vector<ReadForce> read_forces;    // linear connections whose force is an output
};

}  // namespace tonewood
