// Samples in which tensions rise and only linear connections act.
#pragma once

#include "connection_step.hpp"
#include "tension_search.hpp"

namespace tonewood {
namespace {

class TensionStep : public ConnectionStep {
public:
    explicit TensionStep(Block& block)
        : passes(block), search(block, passes), layout_(block.model.layout), solve_(block.model.solve),
          ports_(block.model.tension.ports), statistics_(block.model.statistics) {}

    void begin_block() override { passes.begin_block(); }
    void finish_block() override { passes.finish_block(); }

    bool sample(int b, double* now, double* f_out) override {
        passes.begin_sample(b);
        if (!forces(now, f_out)) return false;
        passes.finish_sample(now);
        return true;
    }

    // Finds the tensions and all forces: port forces `now`, forces f of the linear connections.
    bool forces(double* now, double* f) {
        const bool done = search.find_linear();
        statistics_.failures += !done;
        search.add_moved();
        add_product(ports_.onto_forces.data(), layout_.force_width, ports_.alone.data(), int(ports_.ports.size()),
                    ports_.fixed_part.data(), now);
        if (layout_.own_port.empty()) {
            linear_forces(all_.data());
            std::copy_n(all_.data(), solve_.m, f);
        } else {
            own_forces(layout_, now, solve_.m, f);
        }
        return done;
    }

    // Forces f (f_width) of the linear connections, after search.add_moved.
    void linear_forces(double* f) {
        add_product(ports_.onto_linear.data(), layout_.f_width, ports_.alone.data(), int(ports_.ports.size()),
                    passes.linear_part(), f);
    }

    TensionPasses passes;
    TensionSearch search;

private:
    const Layout& layout_;
    const Solve& solve_;
    TensionPorts& ports_;
    Statistics& statistics_;
    Array<double> all_ = Array<double>(layout_.f_width);
};

}  // namespace
}  // namespace tonewood
