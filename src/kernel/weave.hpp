// One visit per block for components whose modes are each read by one row: pushing them by the forces of the block that
// ends and reading the free motion of the next one while they are in registers.
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
#pragma once

#include "simd.hpp"
#include "sweep.hpp"

namespace tonewood {
namespace {

// N vectors of one field, the first at `lane` of a chunk; chunks are `step` numbers apart.
template <class T, int N>
inline Pack<T, N> field(const T* chunk, std::size_t step, int lane) {
    if constexpr (N == 1) {
        return {Simd<T>::load(chunk + lane)};
    } else {
        const int next = lane + Pack<T, N / 2>::size;
        return {field<T, N / 2>(chunk, step, lane),
                field<T, N / 2>(chunk + next / kChunk<T> * step, step, next % kChunk<T>)};
    }
}
template <class T, int N>
inline void put(const Pack<T, N>& x, T* chunk, std::size_t step, int lane) {
    if constexpr (N == 1) {
        Simd<T>::store(chunk + lane, x.a);
    } else {
        const int next = lane + Pack<T, N / 2>::size;
        put(x.a, chunk, step, lane), put(x.b, chunk + next / kChunk<T> * step, step, next % kChunk<T>);
    }
}

// The modes' own numbers, of which a strand may end within a vector.
template <class T, int N>
inline Pack<T, N> own(const T* x, int left) {
    if (left >= Pack<T, N>::size) return Pack<T, N>::load(x);
    alignas(64) T part[Pack<T, N>::size] = {};
    for (int i = 0; i < left; ++i) part[i] = x[i];
    return Pack<T, N>::load(part);
}
template <class T, int N>
inline void put_own(const Pack<T, N>& value, T* x, int left) {
    if (left >= Pack<T, N>::size) return value.store(x);
    alignas(64) T part[Pack<T, N>::size];
    value.store(part);
    for (int i = 0; i < left; ++i) x[i] = part[i];
}

// Where a pack of a strand lies.
template <class T, int N>
struct Place {
    T *base, *doors;
    std::size_t step, door;
    int lane;
    Place(Woven<T>& woven, const typename Woven<T>::Strand& strand, std::size_t k)
        : base(&woven.data[(strand.chunk + k / kChunk<T>) * woven.step]),
          doors(&woven.doors[(strand.chunk + k / kChunk<T>) * kChunk<T> * Woven<T>::n_doors]),
          step(woven.step), door(std::size_t(kChunk<T>) * Woven<T>::n_doors),
          // packs as wide as a chunk begin with one
          lane(Pack<T, N>::size % kChunk<T> == 0 ? 0 : int(k % kChunk<T>)) {}
    Pack<T, N> operator[](int i) const { return field<T, N>(base + i * kChunk<T>, step, lane); }
    Pack<T, N> at_door(int i) const { return field<T, N>(doors + i * kChunk<T>, door, lane); }
    void set(int i, const Pack<T, N>& x) const { put(x, base + i * kChunk<T>, step, lane); }
};

// N vectors of modes that recur: what moves freely, and what the forces of a block come to at its end.
template <class T, int N, bool slow>
struct Thread {
    using P = Pack<T, N>;
    P other, det, bent, s, t;
    // d+ = det d - kappa s+ as (det - kappa) d - kappa s, which does not wait for s+
    Thread(const P& trace_or_kappa, const P& determinant) : other(trace_or_kappa), det(determinant) {
        if constexpr (slow) bent = det - other;
    }

    // Under the forces of a block: the responses h(0) and h(1) (or e) of port p are numbers 4 + 2p and 5 + 2p.
    void push(const Place<T, N>& at, int n_ports, const double* forces, std::ptrdiff_t stride) {
        one_port(at[4], at[5], forces, stride);
        for (int p = 1; p < n_ports; ++p) one_port(at[4 + 2 * p], at[5 + 2 * p], forces + p, stride);
    }

    void one_port(const P& h0, const P& h1, const double* f, std::ptrdiff_t stride) {
        P u{}, v{};
        if constexpr (slow) {
#pragma GCC unroll 16
            for (int b = 0; b < kBlock; ++b) {
                const P next = mul_add(bent, v, neg_mul_plus(other, u, T(f[b * stride])));
                u = u + v;
                v = next;
            }
            const P sag = other * h0;
            s = mul_add(h0, v, mul_add(h1 + (h0 - det * h0) + sag, u, s));
            t = mul_add(h1, v, neg_mul_add(sag, u, t));
        } else {
#pragma GCC unroll 16
            for (int b = 0; b < kBlock; b += 2) {
                u = mul_add(other, v, neg_mul_plus(det, u, T(f[b * stride])));
                v = mul_add(other, u, neg_mul_plus(det, v, T(f[(b + 1) * stride])));
            }
            s = mul_add(h0, v, mul_add(neg_mul_add(other, h0, h1), u, s));
            t = mul_add(h1, v, neg_mul_add(det * h0, u, t));
        }
    }

    // Adds the next two samples to their sums.
    void read(T* to) {
        const auto add = [](T* at, const P& share) {
            Simd<T>::store(at, Simd<T>::load(at) + share.folded());
        };
        if constexpr (slow) {
            const P next = turned(bent, t, other, s);
            s = s + t;
            add(to, s);
            t = turned(bent, next, other, s);
            s = s + next;
            add(to + Simd<T>::width, s);
        } else {
            add(to, t);
            s = turned(other, t, det, s);
            add(to + Simd<T>::width, s);
            t = turned(other, s, det, t);
        }
    }
};

template <class T, int N, bool slow>
inline void enter(Woven<T>& woven, const typename Woven<T>::Strand& strand, std::size_t k, const T* x, const T* y, T* to) {
    const Place<T, N> at(woven, strand, k);
    const int left = strand.count - int(k);
    const auto first = own<T, N>(x + strand.first + k, left), second = own<T, N>(y + strand.first + k, left);
    Thread<T, N, slow> thread(at[0], at[1]);
    thread.s = mul_add(at.at_door(0), first, at.at_door(1) * second);
    thread.t = mul_add(at.at_door(2), first, at.at_door(3) * second);
    Simd<T>::store(to, Simd<T>::load(to) + thread.s.folded());
#pragma GCC unroll 16
    for (int b = 0; b < kBlock; b += 2) thread.read(to + (b + 1) * Simd<T>::width);
    at.set(2, thread.s), at.set(3, thread.t);
}

template <class T, int N, bool slow>
inline void leave(Woven<T>& woven, const typename Woven<T>::Strand& strand, std::size_t k, T* x, T* y,
                  const double* forces, std::ptrdiff_t stride) {
    const Place<T, N> at(woven, strand, k);
    const int left = strand.count - int(k);
    Thread<T, N, slow> thread(at[0], at[1]);
    thread.s = at[2], thread.t = at[3];
    thread.push(at, woven.n_ports, forces, stride);
    put_own(mul_add(at.at_door(4), thread.s, at.at_door(5) * thread.t), x + strand.first + k, left);
    put_own(mul_add(at.at_door(6), thread.s, at.at_door(7) * thread.t), y + strand.first + k, left);
}

template <class T, int N, bool slow>
inline void pass(Woven<T>& woven, const typename Woven<T>::Strand& strand, std::size_t k, const double* forces,
                 std::ptrdiff_t stride, T* to) {
    const Place<T, N> at(woven, strand, k);
    Thread<T, N, slow> thread(at[0], at[1]);
    thread.s = at[2], thread.t = at[3];
    thread.push(at, woven.n_ports, forces, stride);
#pragma GCC unroll 16
    for (int b = 0; b < kBlock; b += 2) thread.read(to + (b + 1) * Simd<T>::width);
    at.set(2, thread.s), at.set(3, thread.t);
}

enum class Passage { in, on, out };

// In: from the modes' numbers (x, y), reading samples 0 .. kBlock. On: under port forces[b * stride + port] of the
// block that ends, reading samples 1 .. kBlock of the next one. Out: the same without reading, to (x, y).
template <class T, Passage kind>
void weave(Woven<T>& woven, T* x, T* y, const double* forces, std::ptrdiff_t stride, const Rows<T>& rows) {
    T* const acc = kind == Passage::out ? nullptr : accumulators<T>(rows.count);
    for (const auto& strand : woven.strands) {
        T* const to = acc + std::size_t(strand.row) * (kBlock + 1) * Simd<T>::width;
        const auto go = [&]<bool slow>() {
            in_packs<T, kPack>(std::size_t(strand.padded), [&]<int N>(std::size_t k) {
                if constexpr (kind == Passage::in)
                    enter<T, N, slow>(woven, strand, k, x, y, to);
                else if constexpr (kind == Passage::on)
                    pass<T, N, slow>(woven, strand, k, forces, stride, to);
                else
                    leave<T, N, slow>(woven, strand, k, x, y, forces, stride);
            });
        };
        if (strand.slow)
            go.template operator()<true>();
        else
            go.template operator()<false>();
    }
    if constexpr (kind != Passage::out) reduce(acc, rows, kBlock, kind == Passage::in ? 0 : 1);
}

}  // namespace
}  // namespace tonewood
