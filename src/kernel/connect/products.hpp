// Row history and port forces of one block, a line per sample, and products with the matrices of Layout.
#pragma once

#include <algorithm>
#include <vector>

#include "../modal/simd.hpp"

namespace tonewood {
namespace {

constexpr int kSpan = 8;  // samples of a block whose forces reach later lines together

// N vectors of columns of sum = start + matrix^T x over n rows: all, or those of a list. Each number of x is loaded once
// for all of them; four partial sums break the chain of additions.
template <int N, class List>
inline void add_columns(const double* __restrict matrix, int width, const double* __restrict x, int n, const List& list,
                        const double* start, double* sum) {
    using S = Simd;
    S::V part[4][N];
    for (int j = 0; j < N; ++j)
        part[0][j] = S::load(start + j * S::width), part[1][j] = part[2][j] = part[3][j] = S::V{};
    const auto add = [&](int i, S::V* to) {
        const std::ptrdiff_t row = list(i);
        for (int j = 0; j < N; ++j) to[j] += S::load(matrix + row * width + j * S::width) * x[row];
    };
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int q = 0; q < 4; ++q) add(i + q, part[q]);
    for (; i < n; ++i) add(i, part[1]);
    for (int j = 0; j < N; ++j)
        S::store(sum + j * S::width, (part[0][j] + part[1][j]) + (part[2][j] + part[3][j]));
}

// sum = start + matrix^T x over n rows of a (., width) matrix, width a multiple of kLane
template <class List>
inline void add_listed(const double* __restrict matrix, int width, const double* __restrict x, int n, const List& list,
                       const double* start, double* sum) {
    constexpr int lanes = Simd::width, most = kPack - 1;
    static_assert(kLane % lanes == 0);
    int k = 0;
    if (n == 0) {  // an empty matrix has no address to count from
        if (sum != start) std::copy_n(start, width, sum);
        return;
    }
    const auto columns = [&]<int N>() {
        add_columns<N>(matrix + k, width, x, n, list, start + k, sum + k);
        k += N * lanes;
    };
    while (k + most * lanes <= width) columns.template operator()<most>();
    if (most > 2 && k + 2 * lanes <= width) columns.template operator()<2>();
    while (k < width) columns.template operator()<1>();
}
inline void add_product(const double* __restrict matrix, int width, const double* __restrict x, int n, double* sum) {
    add_listed(matrix, width, x, n, [](int i) { return i; }, sum, sum);
}
inline void add_product(const double* __restrict matrix, int width, const double* __restrict x,
                        const std::vector<int>& rows, double* sum) {
    add_listed(matrix, width, x, int(rows.size()), [at = rows.data()](int i) { return at[i]; }, sum, sum);
}

inline double dot(const double* a, const double* b, int n) {
    using S = Simd;
    S::V sums{};
    int j = 0;
    for (; j + S::width <= n; j += S::width) sums += S::load(a + j) * S::load(b + j);
    double rest = 0.0;
    for (; j < n; ++j) rest += a[j] * b[j];
    return n < S::width ? rest : S::sum(sums) + rest;
}

// Port forces of sample b from lines b and b + 1; see PortForces.
class DirectForces {
    using S = Simd;

public:
    explicit DirectForces(const Layout& layout)
        : l_(layout), now_(layout.width + S::width), before_(layout.width + S::width) {}

    // flattened, because compilers do not inline products that several callers use
    __attribute__((flatten)) void operator()(const PortForces& by, const double* __restrict line,
                                             double* __restrict force) {
        // rows that are no port's, and padding, are overwritten by the next segment or lie beyond the last one
        for (const Layout::Segment& segment : l_.segments)
            for (int i = 0; i < segment.n; i += S::width) {
                const double* at = line + segment.row + i;
                S::store(now_.data() + segment.port + i, S::load(at + l_.width) + S::load(at) * by.mix);
                if (!by.old.empty()) S::store(before_.data() + segment.port + i, S::load(at));
            }
        const auto listed = [at = by.rows.data()](int i) { return at[i]; };
        add_listed(by.free.data(), by.width, now_.data(), int(by.rows.size()), listed, by.constant.data(), force);
        if (!by.old.empty()) add_product(by.old.data(), by.width, before_.data(), int(l_.port_rows.size()), force);
    }

private:
    const Layout& l_;
    Array<double> now_, before_;
};

// Response of every row to port forces in the rest of a block. The lines within a span of kSpan samples get the
// response to each force at once; the lines beyond get that to all forces of the span when it ends.
class Propagate {
    using S = Simd;

public:
    explicit Propagate(const Layout& layout) : l_(layout) {}

    // Propagates the forces of sample b; `force` (kBlock, force_width) holds those of all samples so far.
    void operator()(int b, int nb, const double* force, double* history) {
        const int place = b % kSpan, end = std::min(b - place + kSpan, nb);
        const double* now = force + std::size_t(b) * l_.force_width;
        near(now, end - b, history + std::size_t(b + 1) * l_.width);
        if (place == kSpan - 1 && end < nb)
            far(now - std::size_t(kSpan - 1) * l_.force_width, nb - end, history + std::size_t(end + 1) * l_.width);
    }

private:
    void near(const double* __restrict force, int n, double* __restrict history) const {
        static_assert(kSpan == 8);
        switch (n) {
            case 8: return add_span<8>(force, history);
            case 7: return add_span<7>(force, history);
            case 6: return add_span<6>(force, history);
            case 5: return add_span<5>(force, history);
            case 4: return add_span<4>(force, history);
            case 3: return add_span<3>(force, history);
            case 2: return add_span<2>(force, history);
            case 1: return add_span<1>(force, history);
        }
    }

    // Forces of components with P ports: that on the port p of its component in each lane.
    template <int P>
    static S::V on_port(const double* force, int p) {
        if constexpr (P == 1) return S::load(force);
        else return on_port(S::load(force), p, std::make_index_sequence<S::width>{});
    }
    template <std::size_t... I>
    static S::V on_port(S::V f, int p, std::index_sequence<I...>) {
        return p ? __builtin_shufflevector(f, f, int(I | 1)...) : __builtin_shufflevector(f, f, int(I & ~std::size_t(1))...);
    }

    template <int N, int P>
    static void near_alike(const Layout::Alike& those, const double* __restrict force, double* __restrict history,
                           std::ptrdiff_t line_width) {
        for (int i = 0; i < those.width; i += S::width) {
            const double* h = those.response.data() + i;
            double* line = history + those.row + i;
            S::V f[P];
            for (int p = 0; p < P; ++p) f[p] = on_port<P>(force + those.force + i, p);
            for (int k = 0; k < N; ++k, line += line_width) {
                S::V sum = S::load(line);
                for (int p = 0; p < P; ++p, h += those.width) sum += S::load(h) * f[p];
                S::store(line, sum);
            }
        }
    }

    // Response of the n lines after a span to its forces.
    template <int P>
    void far_alike(const Layout::Alike& those, const double* __restrict force, int n,
                   double* __restrict history) const {
        for (int i = 0; i < those.width; i += S::width) {
            S::V f[kSpan][P];
            for (int q = 0; q < kSpan; ++q)
                for (int p = 0; p < P; ++p)
                    f[q][p] = on_port<P>(force + std::size_t(q) * l_.force_width + those.force + i, p);
            const std::ptrdiff_t step = std::ptrdiff_t(P) * those.width;
            const double* h = those.response.data() + kSpan * step + i;
            for (int k = 0; k < n; ++k, h += step) {
                double* line = history + std::size_t(k) * l_.width + those.row + i;
                S::V even = S::load(line), odd{};
                for (int q = 0; q < kSpan; q += 2)
                    for (int p = 0; p < P; ++p) {
                        even += S::load(h - q * step + p * those.width) * f[q][p];
                        odd += S::load(h - (q + 1) * step + p * those.width) * f[q + 1][p];
                    }
                S::store(line, even + odd);
            }
        }
    }

    template <int N>
    void add_span(const double* __restrict force, double* __restrict history) const {
        near_alike<N, 1>(l_.singles, force, history, l_.width);
        near_alike<N, 2>(l_.pairs, force, history, l_.width);
        for (const Layout::Several& c : l_.several) {
            const double* __restrict f = force + c.force;
            if (c.stepped) {
                add_product(c.response.data(), c.width, f, c.n_ports, history + c.row);
                continue;
            }
            const std::ptrdiff_t step = std::ptrdiff_t(c.n_ports) * c.width;
            for (int i = 0; i < c.width; i += S::width) {
                const double* column = c.response.data() + i;
                double* line = history + c.row + i;
                S::V sum[N], odd{};  // the next sample needs the first line
                for (int k = 0; k < N; ++k) sum[k] = S::load(line + std::size_t(k) * l_.width);
                int p = 0;
                for (; p + 1 < c.n_ports; p += 2, column += 2 * c.width) {
                    sum[0] += S::load(column) * f[p];
                    odd += S::load(column + c.width) * f[p + 1];
                    for (int k = 1; k < N; ++k) sum[k] += S::load(column + k * step) * f[p];
                    for (int k = 1; k < N; ++k) sum[k] += S::load(column + k * step + c.width) * f[p + 1];
                }
                if (p < c.n_ports)
                    for (int k = 0; k < N; ++k) sum[k] += S::load(column + k * step) * f[p];
                sum[0] += odd;
                for (int k = 0; k < N; ++k) S::store(line + std::size_t(k) * l_.width, sum[k]);
            }
        }
    }

    // Response of the n lines after a span to its forces.
    void far(const double* __restrict force, int n, double* __restrict history) const {
        far_alike<1>(l_.singles, force, n, history);
        far_alike<2>(l_.pairs, force, n, history);
        for (const Layout::Several& c : l_.several) {
            if (c.stepped) continue;
            const std::ptrdiff_t step = std::ptrdiff_t(c.n_ports) * c.width;
            for (int i = 0; i < c.width; i += S::width) {
                const double* h = c.response.data() + kSpan * step + i;
                double* line = history + c.row + i;
                int k = 0;
                for (; k + 4 <= n; k += 4, h += 4 * step, line += 4 * l_.width) add_later<4>(c, force, h, line);
                for (; k < n; ++k, h += step, line += l_.width) add_later<1>(c, force, h, line);
            }
        }
    }

    // N lines at a time, so that each force is loaded once for all of them
    template <int N>
    void add_later(const Layout::Several& c, const double* __restrict force, const double* h,
                   double* __restrict history) const {
        const std::ptrdiff_t step = std::ptrdiff_t(c.n_ports) * c.width;
        S::V sum[N];
        for (int j = 0; j < N; ++j) sum[j] = S::load(history + std::size_t(j) * l_.width);
        for (int q = 0; q < kSpan; ++q, h -= step) {
            const double* f = force + std::size_t(q) * l_.force_width + c.force;
            for (int p = 0; p < c.n_ports; ++p)
                for (int j = 0; j < N; ++j) sum[j] += S::load(h + j * step + std::ptrdiff_t(p) * c.width) * f[p];
        }
        for (int j = 0; j < N; ++j) S::store(history + std::size_t(j) * l_.width, sum[j]);
    }

    const Layout& l_;
};

// Adds the response of a driven component's rows (n_rows, kBlock + 1) to the port forces of a whole block. A row's
// response has kBlock zeros before it, so that one load serves the force of any sample.
inline void respond(const double* response, int n_ports, int n_rows, const double* forces, int stride, double* rows) {
    using S = Simd;
    constexpr int n_vectors = kBlock / S::width;
    for (int r = 0; r < n_rows; ++r) {
        S::V sum[n_vectors] = {};
        for (int p = 0; p < n_ports; ++p) {
            const double* h = response + std::size_t(p * n_rows + r) * 2 * kBlock + kBlock;
            for (int b = 0; b < kBlock; ++b)
                for (int v = 0; v < n_vectors; ++v) sum[v] += S::load(h - b + v * S::width) * forces[b * stride + p];
        }
        double* const row = rows + std::size_t(r) * (kBlock + 1) + 1;
        for (int v = 0; v < n_vectors; ++v) S::store(row + v * S::width, S::load(row + v * S::width) + sum[v]);
    }
}

}  // namespace
}  // namespace tonewood
