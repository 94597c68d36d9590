// Port-recurrence form: one modal pass per block that moves modes under the forces of the block that ends and reads the
// free motion of the next one, while they are in registers.
//
// It serves components whose modes are each read by one row. Such a mode is stepped in its share s(b) = c E^b x of that
// row instead of its own two numbers: s and s+, or s and d = s+ - s where modes are slow (pass.hpp). With
// h(k) = c E^k w the response to a port force F,
//
//     s(16) = ... + h(0) v + (h(1) - tr h(0)) v-,      s(17) = ... + h(1) v - det h(0) v-,
//     v+ = tr v - det v- + F,
//     s(16) = ... + h(0) v + (e + (2 - tr) h(0)) u,    d(16) = ... + e v - kappa h(0) u,    e = h(1) - h(0),
//     u+ = u + v,  v+ = det v - kappa u+ + F,
//
// and x follows from two values of s. Modes change into this form at the beginning of a window of kWindow blocks and
// back at its end; windows are counted from the run's beginning, so that runs cut there give the same bits. A component
// takes part if no known force acts on it in the window and no contact needs its modes in between.
//
// Each sample of a recurrence waits for the one before it, so several chunks of modes are stepped side by side: those
// of one row first, the rest together with chunks of other components.
#pragma once

#include <algorithm>
#include <vector>

#include "pass.hpp"
#include "resting.hpp"

namespace tonewood {
namespace {

constexpr int kChunkVectors = kChunk / Simd::width;
constexpr int kChunkPack = std::max(1, kPack / kChunkVectors);  // chunks side by side

// Where the numbers of a chunk lie: tables, modes, the forces on its component, the sums of its row.
struct ChunkView {
    double* numbers;  // a copy of the component's: two of them move
    const double* basis;
    double *x, *y, *sum;
    const double* forces;
    int count;   // of modes; the rest is padding
};

// N chunks that use the same recurrence, as one pack of vectors: vector i is vector i % kChunkVectors of chunk
// i / kChunkVectors.
template <int N>
struct ChunkPack {
    static constexpr int vectors = N * kChunkVectors, width = Simd::width;
    using P = Pack<vectors>;
    using V = Simd::V;
    const ChunkView* views;

    static constexpr int chunk(int i) { return i / kChunkVectors; }
    static constexpr int lane(int i) { return i % kChunkVectors * width; }

    P number(int field) const {
        return P::made([&](int i) { return Simd::load(views[chunk(i)].numbers + field * kChunk + lane(i)); });
    }
    P basis(int field) const {
        return P::made([&](int i) { return Simd::load(views[chunk(i)].basis + field * kChunk + lane(i)); });
    }
    void set_number(int field, const P& x) const {
        x.each([&](int i, V v) { Simd::store(views[chunk(i)].numbers + field * kChunk + lane(i), v); });
    }
    // one row: the force is that of one component
    template <bool one_row>
    P force(std::ptrdiff_t at) const {
        const V first = views->forces[at] - V{};
        return P::made([&](int i) { return one_row ? first : views[chunk(i)].forces[at] - V{}; });
    }
    P modes(double* ChunkView::*of) const {
        return P::made([&](int i) {
            const ChunkView& view = views[chunk(i)];
            if (view.count == kChunk) return Simd::load(view.*of + lane(i));
            alignas(64) double part[width] = {};
            for (int k = 0; k < width && lane(i) + k < view.count; ++k) part[k] = (view.*of)[lane(i) + k];
            return Simd::load(part);
        });
    }
    void set_modes(double* ChunkView::*of, const P& x) const {
        x.each([&](int i, V v) {
            const ChunkView& view = views[chunk(i)];
            if (view.count == kChunk) return Simd::store(view.*of + lane(i), v);
            for (int k = 0; k < width && lane(i) + k < view.count; ++k) (view.*of)[lane(i) + k] = v[k];
        });
    }
};

// The recurrence of a pack of chunks.
template <int N, bool slow, bool one_row>
struct Recurrence {
    using C = ChunkPack<N>;
    using P = typename C::P;
    const C chunks;
    const P other, det;  // trace or kappa, determinant
    P bent, s, t;

    explicit Recurrence(const ChunkView* views) : chunks{views}, other(chunks.number(0)), det(chunks.number(1)) {
        // d+ = det d - kappa s+ as (det - kappa) d - kappa s, which does not wait for s+
        if constexpr (slow) bent = det - other;
    }

    // Adds the response to the forces of a block: h(0) and h(1) (or e) of port p are numbers 4 + 2p and 5 + 2p.
    void add_forces(int n_ports, std::ptrdiff_t stride) {
        for (int p = 0; p < n_ports; ++p) {
            P u{}, v{};
            if constexpr (slow) {
#pragma GCC unroll 16
                for (int b = 0; b < kBlock; ++b) {
                    const P force = chunks.template force<one_row>(b * stride + p);
                    const P next = mul_add(bent, v, neg_mul_add(other, u, force));
                    u = u + v;
                    v = next;
                }
            } else {
#pragma GCC unroll 16
                for (int b = 0; b < kBlock; b += 2) {
                    u = mul_add(other, v, neg_mul_add(det, u, chunks.template force<one_row>(b * stride + p)));
                    v = mul_add(other, u, neg_mul_add(det, v, chunks.template force<one_row>((b + 1) * stride + p)));
                }
            }
            const P h0 = chunks.number(4 + 2 * p), h1 = chunks.number(5 + 2 * p);
            if constexpr (slow) {
                const P k0 = other * h0;
                s = mul_add(h0, v, mul_add(h1 + (h0 - det * h0) + k0, u, s));
                t = mul_add(h1, v, neg_mul_add(k0, u, t));
            } else {
                s = mul_add(h0, v, mul_add(neg_mul_add(other, h0, h1), u, s));
                t = mul_add(h1, v, neg_mul_add(det * h0, u, t));
            }
        }
    }

    void add(int b, const P& share) const {
        const auto onto = [&](int i, typename C::V v) {
            double* const at = chunks.views[C::chunk(i)].sum + b * C::width;
            Simd::store(at, Simd::load(at) + v);
        };
        if constexpr (one_row) onto(0, share.folded());
        else share.each(onto);
    }

    // Reads samples 1 .. kBlock of the free motion.
    void read() {
#pragma GCC unroll 16
        for (int b = 1; b < kBlock; b += 2) {
            if constexpr (slow) {
                const P next = recurred(bent, t, other, s);
                s = s + t;
                add(b, s);
                t = recurred(bent, next, other, s);
                s = s + next;
            } else {
                add(b, t);
                s = recurred(other, t, det, s);
                t = recurred(other, s, det, t);
            }
            add(b + 1, s);
        }
    }
};

// enter: from the modes' numbers; reads samples 0 .. kBlock. next: adds the forces of the block that ends; reads
// samples 1 .. kBlock of the next one. leave: adds these forces and goes back to the modes' numbers.
enum class Passage { enter, next, leave };

template <Passage kind, int N, bool slow, bool one_row>
void pass_pack(const ChunkView* views, int n_ports, std::ptrdiff_t stride) {
    Recurrence<N, slow, one_row> r(views);
    const auto& chunks = r.chunks;
    if constexpr (kind == Passage::enter) {
        const auto x = chunks.modes(&ChunkView::x), y = chunks.modes(&ChunkView::y);
        r.s = mul_add(chunks.basis(0), x, chunks.basis(1) * y);
        r.t = mul_add(chunks.basis(2), x, chunks.basis(3) * y);
        r.add(0, r.s);
    } else {
        r.s = chunks.number(2), r.t = chunks.number(3);
        r.add_forces(n_ports, stride);
    }
    if constexpr (kind == Passage::leave) {
        chunks.set_modes(&ChunkView::x, mul_add(chunks.basis(4), r.s, chunks.basis(5) * r.t));
        chunks.set_modes(&ChunkView::y, mul_add(chunks.basis(6), r.s, chunks.basis(7) * r.t));
    } else {
        r.read();
        chunks.set_number(2, r.s), chunks.set_number(3, r.t);
    }
}

// n chunks, in the largest packs first.
template <Passage kind, bool slow, bool one_row, int N = kChunkPack>
void pass_chunks(const ChunkView* views, int n, int n_ports, std::ptrdiff_t stride) {
    for (; n >= N; n -= N, views += N) pass_pack<kind, N, slow, one_row || N == 1>(views, n_ports, stride);
    if constexpr (N > 1) pass_chunks<kind, slow, one_row, N / 2>(views, n, n_ports, stride);
}

// The components in port-recurrence form.
class FusedPass {
public:
    FusedPass(Block& block, const Resting& resting)
        : block_(block), resting_(resting), fused_(block.model.components.size(), 0), wanted_(fused_),
          sums_of_(fused_.size()), driven_(fused_.size()) {
        const auto& components = block.model.components;
        for (std::size_t i = 0; i < components.size(); ++i)
            if (components[i].driven) driven_[i].assign(std::size_t(kBlock + 1) * components[i].n_rows, 0.0);
    }

    // Whether component i is in this form: its rows are read, and its modes stay as they were at the window's
    // beginning.
    bool operator[](int i) const { return fused_[i]; }
    // (n_rows, kBlock + 1): rows of a driven component.
    double* driven_rows(int i) { return driven_[i].data(); }

    // A block begins. In the first one of a window, components change into this form and their free motion is read.
    void begin_block() {
        place_ = int(block_.start / kBlock % kWindow);
        if (place_ > 0) return;
        const bool whole = block_.model.shortcuts.fused_pass && block_.start + kWindow * kBlock <= block_.job.n;
        for (int i = 0; i < int(fused_.size()); ++i) {
            const Component& c = block_.model.components[i];
            wanted_[i] = whole && !resting_[i] && !c.recurrence.chunks.empty() && c.contact.n == 0 && !c.by_sample() &&
                         !block_.forced(i, kWindow * kBlock);
        }
        if (wanted_ != fused_) take(wanted_);
        pass<Passage::enter>();
        write_rows(0);
    }

    // All forces of the block are known and its rows were used.
    void finish_block() {
        if (place_ + 1 == kWindow) return pass<Passage::leave>();
        const auto& layout = block_.model.layout;
        for (int i = 0; i < int(fused_.size()); ++i) {
            if (!fused_[i]) continue;
            const Component& c = block_.model.components[i];
            double* const rows = c.driven ? driven_rows(i) : block_.line(0) + layout.row[i];
            const double* const last = c.driven ? rows + kBlock : block_.line(kBlock) + layout.row[i];
            const int step = c.driven ? kBlock + 1 : 1;
            for (int r = 0; r < c.n_rows; ++r) rows[r * step] = last[r * step];
        }
        pass<Passage::next>();
        write_rows(1);
    }

private:
    static constexpr std::size_t kRow = std::size_t(kBlock + 1) * Simd::width;
    struct Strip {  // rows side by side in a line: of a component and of those after it
        int component, n_rows;
        std::size_t sums;
    };
    struct Packs {
        int first, n;  // views
        int n_ports;
        bool slow, one_row;
    };

    // Takes these components, in place of those before.
    void take(const std::vector<char>& fused) {
        fused_ = fused;
        const auto& components = block_.model.components;
        const auto& layout = block_.model.layout;
        std::size_t n_sums = 0;
        views_.clear(), packs_.clear(), strips_.clear();
        for (std::size_t i = 0; i < fused_.size(); ++i) {
            sums_of_[i] = n_sums;
            if (!fused_[i]) continue;
            const Component& c = components[i];
            Strip* const last = strips_.empty() ? nullptr : &strips_.back();
            if (last && !c.driven && !components[last->component].driven &&
                layout.row[i] == layout.row[last->component] + last->n_rows)
                last->n_rows += c.n_rows;
            else
                strips_.push_back({int(i), c.n_rows, n_sums});
            n_sums += std::size_t(c.n_rows) * kRow;
        }
        sums_.assign(n_sums, 0.0);
        for (const int n_ports : {1, 2})
            for (const bool slow : {false, true}) {
                left_.clear();
                for (std::size_t i = 0; i < fused_.size(); ++i)
                    if (fused_[i] && components[i].recurrence.n_ports == n_ports) add_chunks(i, slow);
                add_packs(left_.data(), left_.size(), n_ports, slow);
            }
    }

    // Adds the chunks of a component with this recurrence: whole packs of one row; the rest is left over for packs of
    // several rows.
    void add_chunks(std::size_t i, bool slow) {
        const Component& c = block_.model.components[i];
        const PortRecurrence& recurrence = c.recurrence;
        const double* const forces = block_.forces.data() + block_.model.layout.port[i];
        for (int row = 0; row < c.n_rows; ++row) {
            const std::size_t before = left_.size();
            for (std::size_t k = 0; k < recurrence.chunks.size(); ++k) {
                const auto& chunk = recurrence.chunks[k];
                if (chunk.row != row || chunk.slow != slow) continue;
                left_.push_back({block_.space.recurrences[i].data() + k * recurrence.step,
                                 recurrence.basis.data() + k * PortRecurrence::basis_step,
                                 block_.x(int(i)) + chunk.first, block_.y(int(i)) + chunk.first,
                                 sums_.data() + (sums_of_[i] + row * kRow), forces, chunk.count});
            }
            const std::size_t whole = (left_.size() - before) / kChunkPack * kChunkPack;
            add_packs(left_.data() + before, whole, recurrence.n_ports, slow);
            left_.erase(left_.begin() + before, left_.begin() + before + whole);
        }
    }

    void add_packs(const ChunkView* views, std::size_t n, int n_ports, bool slow) {
        for (std::size_t k = 0; k < n; k += kChunkPack) {
            const std::size_t end = std::min(k + kChunkPack, n);
            bool one_row = true;
            for (std::size_t i = k; i < end; ++i) one_row = one_row && views[i].sum == views[k].sum;
            packs_.push_back({int(views_.size()), int(end - k), n_ports, slow, one_row});
            views_.insert(views_.end(), views + k, views + end);
        }
    }

    template <Passage kind>
    void pass() {
        if (kind != Passage::leave) std::fill(sums_.begin(), sums_.end(), 0.0);
        for (const Packs& p : packs_) {
            const auto go = [&]<bool slow, bool one_row>() {
                pass_chunks<kind, slow, one_row>(views_.data() + p.first, p.n, p.n_ports,
                                                 block_.model.layout.force_width);
            };
            if (p.one_row) {
                if (p.slow) go.template operator()<true, true>();
                else go.template operator()<false, true>();
            } else if constexpr (kChunkPack > 1) {
                if (p.slow) go.template operator()<true, false>();
                else go.template operator()<false, false>();
            }
        }
    }

    // Writes the rows that the pass read, from sample `first`.
    void write_rows(int first) {
        constexpr int lanes = Simd::width;
        const auto& layout = block_.model.layout;
        for (const Strip& strip : strips_) {
            const Component& c = block_.model.components[strip.component];
            const double* const sum = sums_.data() + strip.sums;
            double* const to = c.driven ? driven_rows(strip.component) : block_.line(0) + layout.row[strip.component];
            if (c.driven || strip.n_rows < lanes) {
                const int samples = c.driven ? 1 : layout.width, rows = c.driven ? kBlock + 1 : 1;
                reduce(sum, {nullptr, nullptr, strip.n_rows, nullptr, to, samples, rows}, kBlock, first);
                continue;
            }
            // several rows of a line at once, the last ones perhaps twice
            for (int r = 0; r < strip.n_rows; r += lanes) {
                const int row = std::min(r, strip.n_rows - lanes);
                for (int s = first; s <= kBlock; ++s)
                    Simd::store(to + s * layout.width + row, sums<lanes>(sum + row * kRow + s * lanes, kRow));
            }
        }
    }

    Block& block_;
    const Resting& resting_;
    std::vector<char> fused_, wanted_;
    int place_ = 0;  // of the block in its window
    std::vector<std::size_t> sums_of_;
    std::vector<Array<double>> driven_;
    Array<double> sums_;
    std::vector<ChunkView> views_, left_;
    std::vector<Packs> packs_;
    std::vector<Strip> strips_;
};

}  // namespace
}  // namespace tonewood
