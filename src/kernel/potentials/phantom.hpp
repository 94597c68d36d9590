// Longitudinal motion of strings, driven one way by their transverse motion (tonewood.physics.coupling.potentials.phantom
// has the equations).
//
// A block's forces follow from the transverse motion of the block before: the modes that take part are stepped once
// more under the forces found, sample by sample, from a copy that is renewed where all modes stand in their own two
// numbers, at the beginning of a window. Then, in each sample,
//
//     s_m = sum_k w_mk x_k x_(k + m) + ...,      e_m = s_m + a_m,      force = EA (s_0 + sum e_m).
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
        for (const PhantomString& string : block.model.potentials.driven) {
            for (const auto& part : string.parts) copies_.emplace_back(2 * part.wide);
        }
        int most = 0;
        for (const PhantomString& string : block.model.potentials.driven)
            for (const auto& part : string.parts) most = std::max(most, width(part, string.order));
        path_.assign(std::size_t(kBlock) * (most + kPadding), 0.0);
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
            std::fill_n(squares_, kBlock * kOrder, 0.0);
            for (const auto& part : string.parts) {
                step(part, string.order, copies_[at++], contacts);
                const int line = width(part, string.order);
                for (int b = 0; b < nb; ++b)
                    add_squares(part, string.order, path_.data() + b * line, squares_ + b * kOrder);
            }
            double *const row = memory(string), *const a = row + kBlock, *const v = a + kPhantomModes;
            std::copy(row + nb, row + kBlock, row);
            for (int b = 0; b < nb; ++b) {
                const double* const s = squares_ + b * kOrder;
                const double* const to = string.steps.data();
                S::V sum{};
                for (int m = 0; m < kPhantomModes && m < string.order; m += S::width) {
                    const S::V square = S::load(s + m + 1), e = S::load(a + m) + square, moving = S::load(v + m);
                    sum += e;
                    S::store(a + m, S::load(to + m) * e + S::load(to + kPhantomModes + m) * moving - square);
                    S::store(v + m,
                             S::load(to + 2 * kPhantomModes + m) * e + S::load(to + 3 * kPhantomModes + m) * moving);
                }
                row[kBlock - nb + b] = string.scale * (s[0] + S::sum(sum));
            }
        }
    }

private:
    static constexpr int kOrder = kPhantomModes + kLane;  // s_0, and those of the modes, padded

    double* memory(const PhantomString& string) const {
        return block_.job.potentials + string.at;
    }
    // Modes of a part in a line of the path, and room for those that are read `order` places further.
    static int width(const PhantomString::Part& part, int order) {
        return part.wide + (order + 2 * kPadding) / kPadding * kPadding;
    }

    // Steps the copy of a part's modes over the block; their first numbers go to path_.
    void step(const PhantomString::Part& part, int order, Array<double>& copy, const ContactRows& contacts) {
        using P = Pack<2>;
        const Component& c = block_.model.components[part.slot];
        const std::size_t n = c.n, own = copy.size() / 2;
        const int line = width(part, order), nb = block_.nb;
        const Layout& l = block_.model.layout;
        inputs_ = block_.inputs[part.slot];
        for (int p = 0; p < c.n_ports; ++p)
            inputs_.push_back(
                {c.w.data() + std::size_t(2 * p) * n, block_.forces.data() + l.port[part.slot] + p, l.force_width});
        contacts.add_inputs(part.slot, inputs_);
        std::fill(path_.begin(), path_.begin() + std::ptrdiff_t(nb) * line, 0.0);
        for (std::size_t k = 0; k < own; k += P::size) {
            P x = P::load(copy.data() + k), y = P::load(copy.data() + own + k);
            const P e00 = P::load(c.e.data() + k), e01 = P::load(c.e.data() + n + k);
            const P e10 = P::load(c.e.data() + 2 * n + k), e11 = P::load(c.e.data() + 3 * n + k);
            for (int b = 0; b < nb; ++b) {
                x.store(path_.data() + std::ptrdiff_t(b) * line + k);
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
        }
    }

    // Adds the s_m of a line x to `squares`, kLane of them at a time.
    void add_squares(const PhantomString::Part& part, int order, const double* x, double* squares) {
        const int n = part.wide;
        for (int k = 0; k < kPhantomModes; ++k) backwards_[kPhantomModes - 1 - k] = k < n ? x[k] : 0.0;
        alignas(64) double lanes[kLane * S::width];
        for (int first = 0; first <= order; first += kLane) {
            const int count = std::min(kLane, order + 1 - first);
            const double *const w = part.weights.data() + std::ptrdiff_t(first) * n, *const y = x + first;
            const auto add = [&]<int Count>() {
                S::V sum[Count] = {};
                for (int k = 0; k < n; k += S::width) {
                    const S::V at = S::load(x + k);
                    for (int m = 0; m < Count; ++m)
                        sum[m] += S::load(w + std::ptrdiff_t(m) * n + k) * at * S::load(y + k + m);
                }
                for (int m = 0; m < Count; ++m) S::store(lanes + m * S::width, sum[m]);
            };
            if (count == kLane) add.template operator()<kLane>();
            else if (count > 2) add.template operator()<kLane - 1>();  // rows beyond the last one are padding
            else add.template operator()<2>();
            for (int m = 0; m < count; ++m) {
                // pairs k and first + m - 1 - k
                const double* const other = part.mirrored.data() + std::ptrdiff_t(first + m) * kPhantomModes;
                S::V sum = S::load(lanes + m * S::width);
                for (int k = 0; k < first + m; k += S::width)
                    sum += S::load(other + k) * S::load(x + k) * S::load(backwards_ + kPhantomModes - first - m + k);
                squares[first + m] += S::sum(sum);
            }
        }
    }

    Block& block_;
    std::vector<Array<double>> due_;     // by component that they act on, (vectors, kBlock): forces in this block
    std::vector<Array<double>> copies_;  // by part: (2, n)
    Array<double> path_;                 // (kBlock, width): first numbers of a part's modes
    std::vector<Input> inputs_;
    alignas(64) double squares_[kBlock * kOrder],
        backwards_[2 * kPhantomModes] = {};  // the lowest modes, the last one first
};

}  // namespace
}  // namespace tonewood
