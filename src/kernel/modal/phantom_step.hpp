// Longitudinal motion of strings, driven one way by their transverse motion (tonewood.coupling.phantoms has the equations).
//
// A block's forces follow from the transverse motion of the block before: the modes that take part are stepped once more
// under the forces found, sample by sample, from a copy that is renewed where all modes stand in their own two numbers,
// at the beginning of a window. Then, in each sample,
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
    explicit PhantomStep(Block& block) : block_(block), due_(block.model.phantoms.size() * kBlock) {
        for (const PhantomString& string : block.model.phantoms) {
            block_.known.push_back(string.target);
            for (const auto& part : string.parts) copies_.emplace_back(2 * part.weights.size() / (string.order + 1));
        }
        int most = 0;
        for (const PhantomString& string : block.model.phantoms)
            for (const auto& part : string.parts) most = std::max(most, width(part, string.order));
        path_.assign(std::size_t(kBlock) * (most + kPadding), 0.0);
    }

    // A block begins: the forces that are due in it become known inputs; before its free motion is read.
    void begin_block() {
        const auto& strings = block_.model.phantoms;
        const bool window = block_.start / kBlock % kWindow == 0;
        for (std::size_t q = 0, at = 0; q < strings.size(); ++q) {
            double* const due = due_.data() + q * kBlock;
            std::copy_n(memory(strings[q]), kBlock, due);
            block_.inputs[strings[q].target].push_back({strings[q].vector.data(), due});
            for (const auto& part : strings[q].parts) {
                Array<double>& copy = copies_[at++];
                if (!window) continue;
                const std::size_t n = copy.size() / 2;
                std::copy_n(block_.x(part.slot), n, copy.begin()), std::copy_n(block_.y(part.slot), n, copy.begin() + n);
            }
        }
    }

    // All forces of the block are known: finds those that are due in the next one; before the modes are moved.
    void finish_block(const ContactRows& contacts) {
        const auto& strings = block_.model.phantoms;
        const int nb = block_.nb;
        for (std::size_t q = 0, at = 0; q < strings.size(); ++q) {
            const PhantomString& string = strings[q];
            std::fill_n(squares_, kBlock * kOrder, 0.0);
            for (const auto& part : string.parts) {
                step(part, string.order, copies_[at++], contacts);
                for (int b = 0; b < nb; ++b) add_squares(part, string.order, path_.data() + b * width(part, string.order), squares_ + b * kOrder);
            }
            double *const row = memory(string), *const a = row + kBlock, *const v = a + kPhantomModes;
            std::copy(row + nb, row + kBlock, row);
            for (int b = 0; b < nb; ++b) {
                const double* const s = squares_ + b * kOrder;
                double sum = s[0];
                for (int m = 0; m < string.order; ++m) {
                    const double e = a[m] + s[m + 1], moving = v[m], *const to = string.steps.data() + 4 * m;
                    sum += e;
                    a[m] = to[0] * e + to[1] * moving - s[m + 1], v[m] = to[2] * e + to[3] * moving;
                }
                row[kBlock - nb + b] = string.scale * sum;
            }
        }
    }

private:
    static constexpr int kOrder = kPhantomModes + 1;

    double* memory(const PhantomString& string) const { return block_.job.phantoms + std::size_t(string.index) * kPhantomMemory; }
    // Modes of a part in a line of the path, and room for those that are read `order` places further.
    static int width(const PhantomString::Part& part, int order) {
        return int(part.weights.size()) / (order + 1) + (order + kPadding) / kPadding * kPadding;
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
            inputs_.push_back({c.w.data() + std::size_t(2 * p) * n, block_.forces.data() + l.port[part.slot] + p, l.force_width});
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

    static void add_squares(const PhantomString::Part& part, int order, const double* x, double* squares) {
        const int n = int(part.weights.size()) / (order + 1);
        for (int m = 0; m <= order; ++m) {
            const double *const w = part.weights.data() + std::ptrdiff_t(m) * n, *const other = part.mirrored.data() + std::ptrdiff_t(m) * order;
            S::V sum{};
            for (int k = 0; k < n; k += S::width) sum += S::load(w + k) * S::load(x + k) * S::load(x + k + m);
            double all = S::sum(sum);
            for (int k = 0; k < m; ++k) all += other[k] * x[k] * x[m - 1 - k];
            squares[m] += all;
        }
    }

    Block& block_;
    Array<double> due_;                  // (strings, kBlock): forces in this block
    std::vector<Array<double>> copies_;  // by part: (2, n)
    Array<double> path_;                 // (kBlock, width): first numbers of a part's modes
    std::vector<Input> inputs_;
    double squares_[kBlock * kOrder];
};

}  // namespace
}  // namespace tonewood
