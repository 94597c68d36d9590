// Interface of a connection step: from the free motion of a sample to the forces of all connections and ports.
#pragma once

#include "../modal/block.hpp"
#include "products.hpp"

namespace tonewood {
namespace {

struct ConnectionStep {
    virtual ~ConnectionStep() = default;
    virtual void begin_block() {}
    // Finds the forces on all fixed ports of sample b (force_width) and of all linear connections (m) from the row
    // history at the sample's beginning and, free of them, at its end. False if they were not found.
    virtual bool sample(int b, double* now, double* f_out) = 0;
    virtual void finish_block() {}
};

// Forces of m linear connections, each from a port on which it alone acts.
inline void own_forces(const Layout& l, const double* now, int m, double* f) {
    if (l.own_in_order)
        for (int j = 0; j < m; ++j) f[j] = l.own_factor[j] * now[j];
    else
        for (int j = 0; j < m; ++j) f[j] = l.own_factor[j] * now[l.own_port[j]];
}

}  // namespace
}  // namespace tonewood
