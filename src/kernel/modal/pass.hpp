// Modal passes over one component, kBlock samples at a time: each mode is loaded once per block and stepped in
// registers. The order of every sum is fixed.
//
// A pass takes one of two forms:
//
// * step by step: x+ = E x in each sample. It takes known inputs and reads any number of rows.
// * by recurrence: by Cayley-Hamilton each mode's share s of a row obeys s++ = tr s+ - det s, and the forces of a block
//   enter through the transposed recurrence (Goertzel)
//       b+ = tr b - det b- + F,      x(kBlock) = E^kBlock x(0) + b W + b- (E - tr) W:
//   three operations per row and sample, two per port, one of which depends on another. For slow modes rounding would
//   grow like kBlock over their angle per sample; differences keep full precision there (Reinsch):
//       s+ = s + d,   d+ = det d - kappa s+,               kappa = det(I - E) = 1 - tr + det,
//       u+ = u + d,   d+ = det d - kappa u+ + F,           x(kBlock) = E^kBlock x(0) + d W + u (I + E - tr) W.
#pragma once

#include "simd.hpp"

namespace tonewood {
namespace {

// Rows to read and their destination: the value of row i at a sample goes to value[sample * sample_stride + i *
// row_stride].
struct Rows {
    const double *rows, *slopes;  // (all, 2, n)
    int count;                  // the first ones,
    const int* list;            // or those of a list
    double* value;
    int sample_stride, row_stride;
    int operator[](int i) const { return list ? list[i] : i; }
};

// Ports with forces:  forces[sample * sample_stride + i * port_stride] on port i.
struct Ports {
    const double *w, *w_slope;  // (all, 2, n)
    int count;
    const int* list;
    const double* forces;
    int sample_stride, port_stride;
    int operator[](int i) const { return list ? list[i] : i; }
};

// Accumulators of rows, one vector per row and sample.
double* accumulators(int n_rows) {
    thread_local Array<double> memory;
    const std::size_t need = std::size_t(n_rows) * (kBlock + 1) * Simd::width;
    if (memory.size() < need) memory.resize(need);
    for (std::size_t i = 0; i < need; ++i) memory[i] = 0.0;
    return memory.data();
}

// Sums of lanes, of vectors `step` numbers apart: pairs are added until one vector holds them all.
template <int Count>
Simd::V sums(const double* acc, std::size_t step = Simd::width) {
    constexpr int width = Simd::width, first = width / Count;  // lanes of a vector that belong to one sum
    if constexpr (Count == 1) {
        return Simd::load(acc);
    } else {
        const auto a = sums<Count / 2>(acc, step), b = sums<Count / 2>(acc + Count / 2 * step, step);
        return [&]<std::size_t... I>(std::index_sequence<I...>) {
            // the sums of a, then those of b, each in half as many lanes as it had
            constexpr auto from = [](int i, int half) {
                const int sum = i / first, inside = i % first;
                return sum / (Count / 2) * width + sum % (Count / 2) * 2 * first + half * first + inside;
            };
            return __builtin_shufflevector(a, b, from(int(I), 0)...) +
                   __builtin_shufflevector(a, b, from(int(I), 1)...);
        }(std::make_index_sequence<width>{});
    }
}

void reduce(const double* acc, const Rows& rows, int nb, int first = 0) {
    constexpr int width = Simd::width;
    for (int r = 0; r < rows.count; ++r) {
        double* to = rows.value + std::ptrdiff_t(rows[r]) * rows.row_stride;
        int s = first;
        acc += first * width;
        for (; s + width <= nb + 1; s += width, acc += width * width) {
            const auto all = sums<width>(acc);
            if (rows.sample_stride == 1)
                Simd::store(to + s, all);
            else
                for (int i = 0; i < width; ++i) to[std::ptrdiff_t(s + i) * rows.sample_stride] = all[i];
        }
        for (; s <= nb; ++s, acc += width) to[std::ptrdiff_t(s) * rows.sample_stride] = Simd::sum(acc);
    }
}

// Calls pass.operator()<pack size>(first mode) over n modes, in the widest packs first.
template <int N, class Pass>
void in_packs(std::size_t n, const Pass& pass, std::size_t k = 0) {
    for (; k + Pack<N>::size <= n; k += Pack<N>::size) pass.template operator()<N>(k);
    if constexpr (N > 1) in_packs<N / 2>(n, pass, k);
}

// Step by step over nb samples. Read: row values at samples 0 .. nb. Store: moves the state to sample nb.
template <bool Read, bool Store>
void step_modes(const Component& c, double* sx, double* sy, const Input* inputs, int n_inputs, int nb,
                const Rows& rows) {
    using P = Pack<2>;
    constexpr int width = Simd::width;
    static_assert(kPadding % P::size == 0);
    const std::size_t n = c.n;
    double* const acc = Read ? accumulators(rows.count) : nullptr;
    alignas(64) double path_x[(kBlock + 1) * P::size], path_y[(kBlock + 1) * P::size];

    for (std::size_t k = 0; k < n; k += P::size) {
        P x = P::load(sx + k), y = P::load(sy + k);
        const P e00 = P::load(c.e.data() + k), e01 = P::load(c.e.data() + n + k);
        const P e10 = P::load(c.e.data() + 2 * n + k), e11 = P::load(c.e.data() + 3 * n + k);
        for (int s = 0; s < nb; ++s) {
            if constexpr (Read) x.store(path_x + s * P::size), y.store(path_y + s * P::size);
            const P recurred = mul_add(e00, x, e01 * y);
            y = mul_add(e11, y, e10 * x);
            x = recurred;
            for (int j = 0; j < n_inputs; ++j) {
                const double f = inputs[j].values[s * inputs[j].stride];
                x = mul_add(P::load(inputs[j].vector + k), f, x);
                y = mul_add(P::load(inputs[j].vector + n + k), f, y);
            }
        }
        if constexpr (Read) {
            x.store(path_x + nb * P::size), y.store(path_y + nb * P::size);
            for (int r = 0; r < rows.count; ++r) {
                const double* row = rows.rows + 2 * std::size_t(rows[r]) * n + k;
                const P rx = P::load(row), ry = P::load(row + n);
                double* to = acc + std::size_t(r) * (nb + 1) * width;
                for (int s = 0; s <= nb; ++s, to += width) {
                    const P share = mul_add(rx, P::load(path_x + s * P::size), ry * P::load(path_y + s * P::size));
                    Simd::store(to, Simd::load(to) + share.folded());
                }
            }
        }
        if constexpr (Store) x.store(sx + k), y.store(sy + k);
    }
    if constexpr (Read) reduce(acc, rows, nb);
}

// By recurrence over a whole block: values of rows, without inputs. The state stays. Two: of both rows of a component
// whose modes read them in one ratio, which take one recurrence.
template <bool Two = false>
void recur_read(const Component& c, const double* sx, const double* sy, const Rows& rows) {
    constexpr int width = Simd::width, size = (kBlock + 1) * width;
    static_assert(kBlock % 2 == 0);
    const std::size_t n = c.n;
    double* const acc = accumulators(rows.count);
    for (int r = 0; r < (Two ? 1 : rows.count); ++r) {
        const double* row = rows.rows + 2 * std::size_t(rows[r]) * n;
        const double* slope = rows.slopes + 2 * std::size_t(rows[r]) * n;
        double* const to = acc + std::size_t(r) * size;
        in_packs<kPack>(n, [&]<int N>(std::size_t k) {
            using P = Pack<N>;
            const P x = P::load(sx + k), y = P::load(sy + k), det = P::load(c.det.data() + k);
            const P ratio = Two ? P::load(c.ratio.data() + k) : P{};
            const auto add = [&](int b, const P& share) {
                double* const at = to + b * width;
                Simd::store(at, Simd::load(at) + share.folded());
                if constexpr (Two) {
                    Simd::V sum = Simd::load(at + size);
                    add_products(sum, ratio, share);
                    Simd::store(at + size, sum);
                }
            };
            P s = mul_add(P::load(row + k), x, P::load(row + n + k) * y);
            P d = mul_add(P::load(slope + k), x, P::load(slope + n + k) * y);
            add(0, s);
            if (c.slow[k / kGranule]) {
                const P kappa = P::load(c.kappa.data() + k);
                for (int b = 1; b <= kBlock; ++b) {
                    s = s + d;
                    d = neg_mul_add(kappa, s, det * d);
                    add(b, s);
                }
            } else {
                const P trace = P::load(c.trace.data() + k);
                P t = s + d;
                for (int b = 1; b < kBlock; b += 2) {
                    add(b, t);
                    s = recurred(trace, t, det, s);
                    add(b + 1, s);
                    t = recurred(trace, s, det, t);
                }
            }
        });
    }
    reduce(acc, rows, kBlock);
}

// By recurrence over a whole block: moves the state by port forces. Advance: and by E^kBlock.
template <bool Advance>
void recur_store(const Component& c, double* sx, double* sy, const Ports& ports) {
    const std::size_t n = c.n;
    in_packs<kPack>(n, [&]<int N>(std::size_t k) {
        using P = Pack<N>;
        const P x = P::load(sx + k), y = P::load(sy + k);
        P nx = x, ny = y;
        if constexpr (Advance) {
            nx = mul_add(P::load(c.e_block.data() + k), x, P::load(c.e_block.data() + n + k) * y);
            ny = mul_add(P::load(c.e_block.data() + 3 * n + k), y, P::load(c.e_block.data() + 2 * n + k) * x);
        }
        static_assert(kGranule % P::size == 0);
        const bool slow = c.slow[k / kGranule] != 0;
        const P det = P::load(c.det.data() + k), other = P::load(slow ? c.kappa.data() + k : c.trace.data() + k);
        for (int i = 0; i < ports.count; ++i) {
            const std::size_t p = ports[i];
            const double* f = ports.forces + std::ptrdiff_t(p) * ports.port_stride;
            P d{}, u{};
            if (slow) {
                for (int b = 0; b < kBlock; ++b) {
                    u = u + d;
                    d = neg_mul_add(other, u, mul_plus(det, d, f[b * ports.sample_stride]));
                }
            } else {
                for (int b = 0; b < kBlock; b += 2) {
                    u = mul_add(other, d, neg_mul_plus(det, u, f[b * ports.sample_stride]));
                    d = mul_add(other, u, neg_mul_plus(det, d, f[(b + 1) * ports.sample_stride]));
                }
            }
            const double *w = ports.w + 2 * p * n + k, *v = ports.w_slope + 2 * p * n + k;
            nx = mul_add(P::load(w), d, mul_add(P::load(v), u, nx));
            ny = mul_add(P::load(w + n), d, mul_add(P::load(v + n), u, ny));
        }
        nx.store(sx + k), ny.store(sy + k);
    });
}

}  // namespace
}  // namespace tonewood
