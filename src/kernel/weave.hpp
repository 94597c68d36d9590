// One visit per block for all components whose modes are each read by one row: pushing them by the forces of the block
// that ends and reading the free motion of the next one while they are in registers.
//
// Such a mode is stepped in what its row reads of it, s(b) = c E^b x, instead of its own two numbers: s and s+, or s
// and d = s+ - s where modes are slow (see sweep.hpp). With h(k) = c E^k w the response to a port force,
//
//     s(16) = ... + h(0) v + (h(1) - tr h(0)) v-,      s(17) = ... + h(1) v - det h(0) v-,
//     v+ = tr v - det v- + F,
//     s(16) = ... + h(0) v + (e + (2 - tr) h(0)) u,    d(16) = ... + e v - kappa h(0) u,    e = h(1) - h(0),
//     u+ = u + v,  v+ = det v - kappa u+ + F,
//
// and x comes back from two samples of s. A mode goes in and out every kWeave blocks, counted from the run's
// beginning, so that runs cut there are the same to the bit.
//
// Every sample waits for the one before it: so chunks of modes are visited several at a time, those that a row has left
// over together with those of other components.
#pragma once

#include <algorithm>
#include <vector>

#include "simd.hpp"
#include "sweep.hpp"

namespace tonewood {
namespace {

constexpr int kChunkVectors = kChunk / Simd::width;
constexpr int kBeam = std::max(1, kPack / kChunkVectors);  // chunks side by side

// A chunk at work: its numbers, its modes, the forces on its component and the sums that its row is read into.
struct Warp {
    double* data;
    const double* doors;
    double *x, *y, *sum;
    const double* forces;
    int count;   // of modes; the rest is padding
};

// N chunks that recur alike, a pack of all their vectors.
template <int N>
struct Beam {
    static constexpr int vectors = N * kChunkVectors, width = Simd::width;
    using P = Pack<vectors>;
    using V = Simd::V;
    const Warp* warps;

    // vector i of a pack is vector i % kChunkVectors of chunk i / kChunkVectors
    static constexpr int chunk(int i) { return i / kChunkVectors; }
    static constexpr int lane(int i) { return i % kChunkVectors * width; }

    P operator[](int field) const {
        return P::made([&](int i) { return Simd::load(warps[chunk(i)].data + field * kChunk + lane(i)); });
    }
    P at_door(int field) const {
        return P::made([&](int i) { return Simd::load(warps[chunk(i)].doors + field * kChunk + lane(i)); });
    }
    void set(int field, const P& x) const {
        x.each([&](int i, V v) { Simd::store(warps[chunk(i)].data + field * kChunk + lane(i), v); });
    }
    // one component's force is loaded once
    template <bool one_row>
    P force(std::ptrdiff_t at) const {
        const V first = warps->forces[at] - V{};
        return P::made([&](int i) { return one_row ? first : warps[chunk(i)].forces[at] - V{}; });
    }
    P modes(double* Warp::*of) const {
        return P::made([&](int i) {
            const Warp& warp = warps[chunk(i)];
            if (warp.count == kChunk) return Simd::load(warp.*of + lane(i));
            alignas(64) double part[width] = {};
            for (int k = 0; k < width && lane(i) + k < warp.count; ++k) part[k] = (warp.*of)[lane(i) + k];
            return Simd::load(part);
        });
    }
    void set_modes(double* Warp::*of, const P& x) const {
        x.each([&](int i, V v) {
            const Warp& warp = warps[chunk(i)];
            if (warp.count == kChunk) return Simd::store(warp.*of + lane(i), v);
            for (int k = 0; k < width && lane(i) + k < warp.count; ++k) (warp.*of)[lane(i) + k] = v[k];
        });
    }
};

// What moves freely in a beam, and what the forces of a block come to at its end.
template <int N, bool slow, bool one_row>
struct Threads {
    using B = Beam<N>;
    using P = typename B::P;
    const B beam;
    const P other, det;  // trace or kappa, determinant
    P bent, s, t;

    explicit Threads(const Warp* warps) : beam{warps}, other(beam[0]), det(beam[1]) {
        // d+ = det d - kappa s+ as (det - kappa) d - kappa s, which does not wait for s+
        if constexpr (slow) bent = det - other;
    }

    // Under the forces of a block: the responses h(0) and h(1) (or e) of port p are numbers 4 + 2p and 5 + 2p.
    void push(int n_ports, std::ptrdiff_t first, std::ptrdiff_t stride) {
        for (int p = 0; p < n_ports; ++p) {
            P u{}, v{};
            if constexpr (slow) {
#pragma GCC unroll 16
                for (int b = 0; b < kBlock; ++b) {
                    const P next = mul_add(bent, v, neg_mul_add(other, u, beam.template force<one_row>(first + b * stride + p)));
                    u = u + v;
                    v = next;
                }
            } else {
#pragma GCC unroll 16
                for (int b = 0; b < kBlock; b += 2) {
                    u = mul_add(other, v, neg_mul_add(det, u, beam.template force<one_row>(first + b * stride + p)));
                    v = mul_add(other, u, neg_mul_add(det, v, beam.template force<one_row>(first + (b + 1) * stride + p)));
                }
            }
            const P h0 = beam[4 + 2 * p], h1 = beam[5 + 2 * p];
            if constexpr (slow) {
                const P sag = other * h0;
                s = mul_add(h0, v, mul_add(h1 + (h0 - det * h0) + sag, u, s));
                t = mul_add(h1, v, neg_mul_add(sag, u, t));
            } else {
                s = mul_add(h0, v, mul_add(neg_mul_add(other, h0, h1), u, s));
                t = mul_add(h1, v, neg_mul_add(det * h0, u, t));
            }
        }
    }

    void add(int b, const P& share) const {
        const auto onto = [&](int i, typename B::V v) {
            double* const at = beam.warps[B::chunk(i)].sum + b * B::width;
            Simd::store(at, Simd::load(at) + v);
        };
        if constexpr (one_row) onto(0, share.folded());
        else share.each(onto);
    }

    void read() {
#pragma GCC unroll 16
        for (int b = 1; b < kBlock; b += 2) {
            if constexpr (slow) {
                const P next = turned(bent, t, other, s);
                s = s + t;
                add(b, s);
                t = turned(bent, next, other, s);
                s = s + next;
            } else {
                add(b, t);
                s = turned(other, t, det, s);
                t = turned(other, s, det, t);
            }
            add(b + 1, s);
        }
    }
};

enum class Passage { in, on, out };

// In: from the modes' numbers, reading samples 0 .. kBlock. On: under the forces of the block that ends, reading samples
// 1 .. kBlock of the next one. Out: the same without reading, to the modes' numbers.
template <Passage kind, int N, bool slow, bool one_row>
void pass_beam(const Warp* warps, int n_ports, std::ptrdiff_t first, std::ptrdiff_t stride) {
    Threads<N, slow, one_row> threads(warps);
    const auto& beam = threads.beam;
    if constexpr (kind == Passage::in) {
        const auto x = beam.modes(&Warp::x), y = beam.modes(&Warp::y);
        threads.s = mul_add(beam.at_door(0), x, beam.at_door(1) * y);
        threads.t = mul_add(beam.at_door(2), x, beam.at_door(3) * y);
        threads.add(0, threads.s);
    } else {
        threads.s = beam[2], threads.t = beam[3];
        threads.push(n_ports, first, stride);
    }
    if constexpr (kind == Passage::out) {
        beam.set_modes(&Warp::x, mul_add(beam.at_door(4), threads.s, beam.at_door(5) * threads.t));
        beam.set_modes(&Warp::y, mul_add(beam.at_door(6), threads.s, beam.at_door(7) * threads.t));
    } else {
        threads.read();
        beam.set(2, threads.s), beam.set(3, threads.t);
    }
}

// n <= N chunks.
template <Passage kind, bool slow, bool one_row, int N = kBeam>
void pass(const Warp* warps, int n, int n_ports, std::ptrdiff_t first, std::ptrdiff_t stride) {
    for (; n >= N; n -= N, warps += N) pass_beam<kind, N, slow, one_row || N == 1>(warps, n_ports, first, stride);
    if constexpr (N > 1) pass<kind, slow, one_row, N / 2>(warps, n, n_ports, first, stride);
}

// The chunks of all components that are woven, in beams.
class Loom {
public:
    Loom(std::vector<Component>& components, const Layout& layout, const double* force, const Job& job)
        : components_(components), layout_(layout), force_(force), job_(job), sums_of_(components.size()) {}

    // Takes these components up, instead of what it had.
    void set(const std::vector<char>& woven) {
        std::size_t n_sums = 0;
        warps_.clear(), beams_.clear(), strips_.clear();
        for (std::size_t i = 0; i < components_.size(); ++i) {
            sums_of_[i] = n_sums;
            if (!woven[i]) continue;
            const Component& c = components_[i];
            Strip* const last = strips_.empty() ? nullptr : &strips_.back();
            if (last && !c.driven && !components_[last->component].driven &&
                layout_.row[i] == layout_.row[last->component] + last->n_rows)
                last->n_rows += c.n_rows;
            else
                strips_.push_back({int(i), c.n_rows, n_sums});
            n_sums += std::size_t(c.n_rows) * kRow;
        }
        sums_.assign(n_sums, 0.0);
        for (const int n_ports : {1, 2})
            for (const bool slow : {false, true}) {
                left_.clear();
                for (std::size_t i = 0; i < components_.size(); ++i)
                    if (woven[i] && components_[i].woven.n_ports == n_ports) take(i, slow);
                put(left_.data(), left_.size(), n_ports, slow);
            }
    }

    // `first`: of the block's forces among those that the loom was told of.
    template <Passage kind>
    void pass(std::ptrdiff_t first) {
        if (kind != Passage::out) std::fill(sums_.begin(), sums_.end(), 0.0);
        for (const Beams& b : beams_) {
            const auto go = [&]<bool slow, bool one_row>() {
                tonewood::pass<kind, slow, one_row>(warps_.data() + b.first, b.n, b.n_ports, first, layout_.force_width);
            };
            if (b.one_row) {
                if (b.slow) go.template operator()<true, true>();
                else go.template operator()<false, true>();
            } else if constexpr (kBeam > 1) {
                if (b.slow) go.template operator()<true, false>();
                else go.template operator()<false, false>();
            }
        }
    }

    // What the last pass read, from sample `first`: into the lines of two-way components, the rows of driven ones.
    void unwind(double* lines, std::vector<Array<double>>& driven, int first) const {
        constexpr int lanes = Simd::width;
        for (const Strip& strip : strips_) {
            const Component& c = components_[strip.component];
            const double* const acc = sums_.data() + strip.sums;
            double* const to = c.driven ? driven[strip.component].data() : lines + layout_.row[strip.component];
            if (c.driven || strip.n_rows < lanes) {
                const int samples = c.driven ? 1 : layout_.width, rows = c.driven ? kBlock + 1 : 1;
                reduce(acc, {nullptr, nullptr, strip.n_rows, nullptr, to, samples, rows}, kBlock, first);
                continue;
            }
            // several rows of a line at once, the last ones perhaps twice
            for (int r = 0; r < strip.n_rows; r += lanes) {
                const int row = std::min(r, strip.n_rows - lanes);
                for (int s = first; s <= kBlock; ++s)
                    Simd::store(to + s * layout_.width + row, sums<lanes>(acc + row * kRow + s * lanes, kRow));
            }
        }
    }

private:
    static constexpr std::size_t kRow = std::size_t(kBlock + 1) * Simd::width;
    struct Strip {  // rows side by side in a line, of a component and those after it
        int component, n_rows;
        std::size_t sums;
    };
    struct Beams {
        int first, n;  // warps
        int n_ports;
        bool slow, one_row;
    };

    // The chunks of a component that recur this way: whole beams of one row at once, what is left over later.
    void take(std::size_t i, bool slow) {
        Component& c = components_[i];
        Woven& woven = c.woven;
        for (int row = 0; row < c.n_rows; ++row) {
            const std::size_t before = left_.size();
            for (std::size_t k = 0; k < woven.chunks.size(); ++k) {
                const auto& chunk = woven.chunks[k];
                if (chunk.row != row || chunk.slow != slow) continue;
                double* const modes = job_.modes[0] + c.offset + chunk.first;
                double* const others = job_.modes[1] + c.offset + chunk.first;
                left_.push_back({woven.data.data() + k * woven.step, woven.doors.data() + (k * Woven::door_step),
                                 modes, others, sums_.data() + (sums_of_[i] + row * kRow), force_ + layout_.port[i], chunk.count});
            }
            const std::size_t whole = (left_.size() - before) / kBeam * kBeam;
            put(left_.data() + before, whole, woven.n_ports, slow);
            left_.erase(left_.begin() + before, left_.begin() + before + whole);
        }
    }

    void put(const Warp* warps, std::size_t n, int n_ports, bool slow) {
        for (std::size_t k = 0; k < n; k += kBeam) {
            const std::size_t end = std::min(k + kBeam, n);
            bool one_row = true;
            for (std::size_t i = k; i < end; ++i) one_row = one_row && warps[i].sum == warps[k].sum;
            beams_.push_back({int(warps_.size()), int(end - k), n_ports, slow, one_row});
            warps_.insert(warps_.end(), warps + k, warps + end);
        }
    }

    std::vector<Component>& components_;
    const Layout& layout_;
    const double* force_;
    const Job& job_;
    std::vector<std::size_t> sums_of_;
    Array<double> sums_;
    std::vector<Warp> warps_, left_;
    std::vector<Beams> beams_;
    std::vector<Strip> strips_;
};

}  // namespace
}  // namespace tonewood
