// Components at rest on which no nonlinear law and no known force acts, and whose linear connections join no other
// component (a plane of motion with a rigid end). They stay exactly at rest and are not stepped.
#pragma once

#include <algorithm>

#include "block.hpp"

namespace tonewood {
namespace {

class Resting {
public:
    explicit Resting(Block& block) : block_(block), rests_(block.model.components.size(), 0) {
        const Model& m = block.model;
        if (!m.shortcuts.at_rest) return;
        std::vector<char> may = m.layout.by_itself;
        for (const Nonlinear::Term& t : m.nonlinear.all_terms) may[t.component] = 0;
        for (int i = 0; i < int(may.size()); ++i)
            if (may[i] && !m.components[i].by_sample()) candidates_.push_back(i);
    }

    bool operator[](int i) const { return rests_[i]; }

    // Begins a block; the first one of a window finds which components rest.
    void begin_block() {
        if (block_.start / kBlock % kWindow != 0) return;
        for (const int i : candidates_) {
            const bool before = rests_[i];
            rests_[i] = (before || (is_zero(block_.x(i), i) && is_zero(block_.y(i), i))) &&
                        !block_.forced(i, kWindow * kBlock);
            if (before || !rests_[i]) continue;
            const int row = block_.model.layout.row[i];
            for (int b = 0; b <= kBlock; ++b) std::fill_n(block_.line(b) + row, block_.model.components[i].n_rows, 0.0);
        }
    }

private:
    bool is_zero(const double* x, int i) const {
        return std::all_of(x, x + block_.model.components[i].n, [](double v) { return v == 0.0; });
    }

    Block& block_;
    std::vector<char> rests_;
    std::vector<int> candidates_;
};

}  // namespace
}  // namespace tonewood
