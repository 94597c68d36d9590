// Displacements of contact ports in a block and the forces on them.
//
// They are stored apart from the row history. The response of each row to each force is added sample by sample in one
// order, so that a row has the same value whether it was read at the block's beginning or when its contact was added.
#pragma once

#include <algorithm>

#include "../modal/block.hpp"
#include "../modal/pass.hpp"

namespace tonewood {
namespace {

class ContactRows {
    using Term = Nonlinear::Term;

public:
    explicit ContactRows(Block& block)
        : block_(block), components_(block.model.components), layout_(block.model.layout), nl_(block.model.nonlinear),
          ws_(block.space.contacts) {}

    // Samples 0 .. nb of contact port `port` of component i; forces on it.
    double* value(int i, int port) const { return ws_.value.data() + std::size_t(nl_.first[i] + port) * kStride; }
    double* force(int i, int port) const { return ws_.force.data() + std::size_t(nl_.first[i] + port) * kBlock; }
    double* line_of(const Term& t) const { return block_.history.data() + layout_.row[t.component] + t.port; }
    bool loads() const { return loads_; }

    // No contact port is loaded in a new block.
    void begin_block() {
        if (!loads_) return;
        loads_ = false;
        for (auto& list : ws_.loaded) list.clear();
        std::fill(ws_.is_loaded.begin(), ws_.is_loaded.end(), 0);
    }
    void forget_rows() {
        reads_ = false;
        for (auto& list : ws_.rows_read) list.clear();
        std::fill(ws_.row_is_read.begin(), ws_.row_is_read.end(), 0);
    }

    // The port's row is read from now on; the rows of tension-modulated strings are read anew in each sample.
    void mark(const Term& t) {
        char& read = ws_.row_is_read[nl_.first[t.component] + t.port];
        if (!read) ws_.rows_read[t.component].push_back(t.port);
        read = 1, reads_ = reads_ || !block_.modulated(t.component);
    }
    bool is_read(const Term& t) const { return ws_.row_is_read[nl_.first[t.component] + t.port]; }

    // Free motion over the block of all rows marked.
    void read_all() {
        for (int i = 0; reads_ && i < int(components_.size()); ++i)
            if (!ws_.rows_read[i].empty() && !block_.modulated(i))
                read(i, ws_.rows_read[i].data(), int(ws_.rows_read[i].size()));
    }

    // Motion of one more row from the block's beginning up to sample b.
    void read_late(const Term& t, int b) {
        mark(t);
        const int i = t.component;
        if (block_.modulated(i)) return;
        read(i, &t.port, 1);
        for (int s = 0; s < b; ++s) {
            double* later = value(i, t.port) + s + 1;
            const double* then = block_.force(s) + layout_.port[i];
            for (int p = 0; p < components_[i].n_ports; ++p) respond_to_fixed(i, p, t.port, then[p], later);
            for (const int p : ws_.loaded[i]) respond_to_contact(i, p, t.port, s, later);
        }
    }

    // A force acts on a contact port in this block; true if none did before.
    bool load(const Term& t) {
        const int port = nl_.first[t.component] + t.port;
        if (ws_.is_loaded[port]) return false;
        ws_.is_loaded[port] = 1, loads_ = true;
        std::fill_n(force(t.component, t.port), kBlock, 0.0);
        auto& list = ws_.loaded[t.component];
        list.insert(std::upper_bound(list.begin(), list.end(), t.port), t.port);
        return true;
    }

    void clear_forces(int b) {
        if (!loads_) return;
        for (std::size_t i = 0; i < components_.size(); ++i)
            for (const int p : ws_.loaded[i]) force(int(i), p)[b] = 0.0;
    }

    // Response of contact rows to all forces of sample b, and of all other rows to forces on contact ports, in the rest
    // of the block.
    void propagate(int b, const double* now) {
        if (!reads_ && !loads_) return;
        for (int i = 0; i < int(components_.size()); ++i) {
            if (block_.modulated(i)) continue;
            const Component& c = components_[i];
            for (const int p : ws_.loaded[i]) {
                const double f = force(i, p)[b];
                const double* h = c.contact.on_rows.data() + std::size_t(p) * kBlock * c.n_rows;
                for (int k = 0; k < block_.nb - b; ++k, h += c.n_rows) {
                    double* line = block_.line(b + 1 + k) + layout_.row[i];
                    for (int r = 0; r < c.n_rows; ++r) line[r] += h[r] * f;
                }
            }
            for (const int r : ws_.rows_read[i]) {
                double* later = value(i, r) + b + 1;
                for (int p = 0; p < c.n_ports; ++p) respond_to_fixed(i, p, r, now[layout_.port[i] + p], later);
                for (const int p : ws_.loaded[i]) respond_to_contact(i, p, r, b, later);
            }
        }
    }

    // Forces on contact ports as inputs of a component that is stepped sample by sample.
    void add_inputs(int i, std::vector<Input>& inputs) const {
        if (!loads_) return;
        const Component& c = components_[i];
        for (const int p : ws_.loaded[i])
            inputs.push_back({c.contact.w.data() + std::size_t(2 * p) * c.n, force(i, p), 1});
    }

    // Moves the modes of a component by the forces on its contact ports over a whole block.
    void move_modes(int i, double* x, double* y) const {
        if (!loads_ || ws_.loaded[i].empty()) return;
        const ContactPorts& g = components_[i].contact;
        recur_store<false>(
            components_[i], x, y,
            {g.w.data(), g.w_slope.data(), int(ws_.loaded[i].size()), ws_.loaded[i].data(), force(i, 0), 1, kBlock});
    }

private:
    void read(int i, const int* list, int count) {
        const Component& c = components_[i];
        const ContactPorts& g = c.contact;
        block_.space.statistics.rows_read += count;
        const Rows rows{g.rows.data(), g.slopes.data(), count, list, value(i, 0), 1, kStride};
        const auto& inputs = block_.inputs[i];
        if (inputs.empty() && block_.nb == kBlock && g.n <= 2)
            recur_read(c, block_.x(i), block_.y(i), rows);
        else
            step_modes<true, false>(c, block_.x(i), block_.y(i), inputs.data(), int(inputs.size()), block_.nb, rows);
    }

    void respond_to_fixed(int i, int p, int row, double f, double* later) const {
        const ContactPorts& g = components_[i].contact;
        add_response(g.from_fixed.data() + (std::size_t(p) * g.n + row) * kBlock, f, later);
    }
    void respond_to_contact(int i, int p, int row, int b, double* later) const {
        const ContactPorts& g = components_[i].contact;
        add_response(g.from_contact.data() + (std::size_t(p) * g.n + row) * kBlock, force(i, p)[b], later);
    }
    static void add_response(const double* h, double f, double* later) {
        for (int k = 0; k < kBlock; ++k) later[k] += h[k] * f;
    }

    Block& block_;
    const std::vector<Component>& components_;
    const Layout& layout_;
    const Nonlinear& nl_;
    ContactState& ws_;
    bool reads_ = false, loads_ = true;  // whether rows are read, and ports loaded, in this block
};

}  // namespace
}  // namespace tonewood
