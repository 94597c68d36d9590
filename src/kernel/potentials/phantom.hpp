// Longitudinal motion of strings, driven one way by their transverse motion (tonewood.physics.coupling.potentials.phantom
// has the equations).
//
// A block's forces follow from the transverse motion of the block before: the modes that take part are stepped once
// more under the forces found, sample by sample, from a copy that is renewed where all modes stand in their own two
// numbers, at the beginning of a window. Then, in each sample,
//
//     s_m = sum_k w_mk x_k x_(k + m) + ...,      e_m = s_m + a_m,      force = EA (s_0 + sum e_m).
//
// s_m is held for half a sample to each side: a_m is kept for the time half a sample before, e_m is that in the middle.
// The s_m have the samples of the block side by side: each weight is read once a block, and no lanes are added.
#pragma once

#include <algorithm>
#include <vector>

#include "../cull/contact_rows.hpp"

namespace tonewood {
namespace {

class PhantomStep {
    using S = Simd;

public:
    explicit PhantomStep(Block& block) : block_(block) {
        for (const DrivenForces& forces : block.model.potentials.driven_forces)
            block_.known.push_back(forces.target), due_.emplace_back(forces.count * kBlock);
        std::size_t most = 0;
        for (const PhantomString& string : block.model.potentials.driven)
            for (const auto& part : string.parts) {
                copies_.emplace_back(2 * padded_modes(part));
                most = std::max(most, padded_modes(part));
            }
        path_.assign(kBlock * (most + kPhantomModes + kTile), 0.0);
    }

    // A block begins: the forces that are due in it become known inputs; before its free motion is read.
    void begin_block() {
        const auto& strings = block_.model.potentials.driven;
        const bool window = block_.start / kBlock % kWindow == 0;
        for (std::size_t i = 0; i < due_.size(); ++i) {
            const DrivenForces& forces = block_.model.potentials.driven_forces[i];
            const std::size_t size = 2 * std::size_t(block_.model.components[forces.target].n);
            for (std::size_t j = 0; j < forces.count; ++j) {
                double* const due = due_[i].data() + j * kBlock;
                std::fill_n(due, kBlock, 0.0);
                for (std::size_t q = 0; q < strings.size(); ++q)
                    for (int b = 0; b < kBlock; ++b)
                        due[b] += forces.shares[j * strings.size() + q] * memory(strings[q])[b];
                block_.inputs[forces.target].push_back({forces.vectors.data() + j * size, due});
            }
        }
        for (std::size_t q = 0, at = 0; q < strings.size(); ++q) {
            for (const auto& part : strings[q].parts) {
                Array<double>& copy = copies_[at++];
                if (!window) continue;
                const std::size_t n = copy.size() / 2;
                std::copy_n(block_.x(part.slot), n, copy.begin()),
                    std::copy_n(block_.y(part.slot), n, copy.begin() + n);
            }
        }
    }

    // All forces of the block are known: finds those that are due in the next one; before the modes are moved.
    void finish_block(const ContactRows& contacts) {
        const auto& strings = block_.model.potentials.driven;
        const int nb = block_.nb;
        for (std::size_t q = 0, at = 0; q < strings.size(); ++q) {
            const PhantomString& string = strings[q];
            std::fill_n(sums_, kOrder * kBlock, 0.0);
            for (const auto& part : string.parts) {
                step(part, string.order, copies_[at++], contacts);
                add_squares<kTile>(part, string.order);
            }
            for (int m = 0; m < string.order + S::width; m += S::width)
                for (int b = 0; b < kBlock; b += S::width)
                    S::transpose(sums_ + m * kBlock + b, kBlock, squares_ + b * kOrder + m, kOrder);
            double *const row = memory(string), *const a = row + kBlock, *const v = a + kPhantomModes;
            std::copy(row + nb, row + kBlock, row);
            for (int b = 0; b < nb; ++b) {
                const double* const s = squares_ + b * kOrder;
                const double* const to = string.steps.data();
                S::V sum{};
                for (int m = 0; m < kPhantomModes && m < string.order; m += S::width) {
                    const S::V square = S::load(s + m + 1), e = S::load(a + m) + square, moving = S::load(v + m);
                    sum += S::load(to + 4 * kPhantomModes + m) * e + S::load(to + 5 * kPhantomModes + m) * moving;
                    S::store(a + m, S::load(to + m) * e + S::load(to + kPhantomModes + m) * moving - square);
                    S::store(v + m,
                             S::load(to + 2 * kPhantomModes + m) * e + S::load(to + 3 * kPhantomModes + m) * moving);
                }
                row[kBlock - nb + b] = string.scale * (s[0] + S::sum(sum));
            }
        }
    }

private:
    static constexpr int kTile = 2 * kPack;               // s_m at a time
    static constexpr int kOrder = kPhantomModes + kLane;  // s_0, and those of the modes, padded

    double* memory(const PhantomString& string) const {
        return block_.job.potentials + string.at;
    }
    static std::size_t padded_modes(const PhantomString::Part& part) {
        return std::size_t(part.n + kPadding - 1) / kPadding * kPadding;
    }

    // Steps the copy of a part's modes over the block; their first numbers go to path_.
    void step(const PhantomString::Part& part, int order, Array<double>& copy, const ContactRows& contacts) {
        using P = Pack<2>;
        const Component& c = block_.model.components[part.slot];
        const std::size_t n = c.n, own = copy.size() / 2;
        const int nb = block_.nb;
        const Layout& l = block_.model.layout;
        inputs_ = block_.inputs[part.slot];
        for (int p = 0; p < c.n_ports; ++p)
            inputs_.push_back(
                {c.w.data() + std::size_t(2 * p) * n, block_.forces.data() + l.port[part.slot] + p, l.force_width});
        contacts.add_inputs(part.slot, inputs_);
        alignas(64) double block[kBlock * P::size] = {};
        for (std::size_t k = 0; k < own; k += P::size) {
            P x = P::load(copy.data() + k), y = P::load(copy.data() + own + k);
            const P e00 = P::load(c.e.data() + k), e01 = P::load(c.e.data() + n + k);
            const P e10 = P::load(c.e.data() + 2 * n + k), e11 = P::load(c.e.data() + 3 * n + k);
            for (int b = 0; b < nb; ++b) {
                x.store(block + b * P::size);
                const P moved = mul_add(e00, x, e01 * y);
                y = mul_add(e11, y, e10 * x);
                x = moved;
                for (const Input& input : inputs_) {
                    const double f = input.values[b * input.stride];
                    x = mul_add(P::load(input.vector + k), f, x);
                    y = mul_add(P::load(input.vector + n + k), f, y);
                }
            }
            x.store(copy.data() + k), y.store(copy.data() + own + k);
            for (int i = 0; i < P::size; i += S::width)
                for (int b = 0; b < kBlock; b += S::width)
                    S::transpose(block + b * P::size + i, P::size, path_.data() + (k + i) * kBlock + b, kBlock);
        }
        // in place of modes after the last one
        std::fill_n(path_.begin() + part.n * kBlock, (order + kTile) * kBlock, 0.0);
    }

    // Adds the s_m of a part to sums_, two vectors of samples side by side, s_first and those after it.
    template <int Most>
    void add_squares(const PhantomString::Part& part, int order, int first = 0) {
        using P = Pack<2>;
        for (; first + Most <= order + 1; first += Most) {
            for (int b = 0; b < kBlock; b += P::size) {
                const double* const path = path_.data() + b;
                P sum[Most] = {};
                for (int k = 0; k < part.n - first; ++k) {
                    const double* const w = part.weights.data() + std::ptrdiff_t(k) * (order + 1) + first;
                    const P x = P::load(path + k * kBlock);
                    for (int m = 0; m < Most; ++m)
                        sum[m] = mul_add(x * P::load(path + (k + first + m) * kBlock), w[m], sum[m]);
                }
                for (int m = 0; m < Most; ++m) {
                    // pairs k and first + m - 1 - k
                    const double* const w = part.mirrored.data() + (first + m) * kPhantomModes / 2;
                    for (int k = 0; 2 * k < first + m; ++k)
                        sum[m] = mul_add(P::load(path + k * kBlock) * P::load(path + (first + m - 1 - k) * kBlock),
                                         w[k], sum[m]);
                    double* const to = sums_ + (first + m) * kBlock + b;
                    mul_add(sum[m], 1.0, P::load(to)).store(to);
                }
            }
        }
        if constexpr (Most > 1) add_squares<Most / 2>(part, order, first);
    }

    Block& block_;
    std::vector<Array<double>> due_;     // by component that they act on, (vectors, kBlock): forces in this block
    std::vector<Array<double>> copies_;  // by part: (2, n)
    Array<double> path_;                 // (modes of a part, kBlock): their first numbers; zeros follow
    std::vector<Input> inputs_;
    alignas(64) double sums_[kOrder * kBlock], squares_[kBlock * kOrder];  // s_m: by mode, and by sample
};

}  // namespace
}  // namespace tonewood
