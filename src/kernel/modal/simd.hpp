// Vectors of the translation unit's instruction set, in packs of several so that their latencies overlap.
#pragma once

#include <utility>

#include "../data/state.hpp"

namespace tonewood {
namespace {

#if defined(__AVX512F__)
constexpr int kVectorBytes = 64;
constexpr int kPack = 4;  // 32 registers
#elif defined(__AVX2__)
constexpr int kVectorBytes = 32;
constexpr int kPack = 2;  // 16 registers
#else
constexpr int kVectorBytes = 16;
constexpr int kPack = 2;
#endif

struct Simd {
    static constexpr int width = kVectorBytes / int(sizeof(double));
    typedef double V __attribute__((vector_size(kVectorBytes)));
    // arrays that come from Python need not be aligned to the vector
    typedef double Loose __attribute__((vector_size(kVectorBytes), aligned(alignof(double)), may_alias));
    static V load(const double* p) { return V(*reinterpret_cast<const Loose*>(p)); }
    static void store(double* p, V v) { *reinterpret_cast<Loose*>(p) = v; }
    // Sum of the lanes: halves are added until one is left.
    static double sum(V v) { return folded<width / 2>(v, std::make_index_sequence<width>{})[0]; }
    static double sum(const double* p) { return sum(load(p)); }
    static double largest(V v) { return peak<width / 2>(v, std::make_index_sequence<width>{})[0]; }
    template <int Half, std::size_t... I>
    static V peak(V v, std::index_sequence<I...> lanes) {
        if constexpr (Half == 0) {
            return v;
        } else {
            const V other = __builtin_shufflevector(v, v, int(I ^ Half)...);
            return peak<Half / 2>(v > other ? v : other, lanes);
        }
    }
    // Transposes width x width numbers, whose rows are a stride apart.
    static void transpose(const double* from, std::ptrdiff_t stride, double* to, std::ptrdiff_t to_stride) {
        V rows[width];
        for (int i = 0; i < width; ++i) rows[i] = load(from + i * stride);
        exchange<1>(rows, std::make_index_sequence<width>{});
        for (int i = 0; i < width; ++i) store(to + i * to_stride, rows[i]);
    }
    // Exchanges what lies off the diagonal in blocks of 2 Size rows and columns, then in larger ones.
    template <int Size, std::size_t... I>
    static void exchange(V* rows, std::index_sequence<I...> lanes) {
        if constexpr (Size < width) {
            for (int i = 0; i < width; ++i) {
                if (i & Size) continue;
                const V a = rows[i], b = rows[i + Size];
                rows[i] = __builtin_shufflevector(a, b, (int(I) & Size ? width + int(I) - Size : int(I))...);
                rows[i + Size] = __builtin_shufflevector(a, b, (int(I) & Size ? width + int(I) : int(I) + Size)...);
            }
            exchange<2 * Size>(rows, lanes);
        }
    }
    template <int Half, std::size_t... I>
    static V folded(V v, std::index_sequence<I...> lanes) {
        if constexpr (Half == 0) return v;
        else return folded<Half / 2>(v + __builtin_shufflevector(v, v, int(I ^ Half)...), lanes);
    }
};

// A few doubles, fewer than a vector holds.
template <int N>
struct Lanes;

template <>
struct Lanes<1> {
    static constexpr int width = 1;
    using V = double;
    static V load(const double* p) { return *p; }
    static void store(double* p, V v) { *p = v; }
    static double sum(V v) { return v; }
    static double largest(V v) { return v; }
};
template <>
struct Lanes<2> {
    static constexpr int width = 2;
    typedef double V __attribute__((vector_size(16)));
    typedef double Loose __attribute__((vector_size(16), aligned(alignof(double)), may_alias));
    static V load(const double* p) { return V(*reinterpret_cast<const Loose*>(p)); }
    static void store(double* p, V v) { *reinterpret_cast<Loose*>(p) = v; }
    static double sum(V v) { return v[0] + v[1]; }
    static double largest(V v) { return v[0] > v[1] ? v[0] : v[1]; }
};
template <>
struct Lanes<4> {
    static constexpr int width = 4;
    typedef double V __attribute__((vector_size(32)));
    typedef double Loose __attribute__((vector_size(32), aligned(alignof(double)), may_alias));
    static V load(const double* p) { return V(*reinterpret_cast<const Loose*>(p)); }
    static void store(double* p, V v) { *reinterpret_cast<Loose*>(p) = v; }
    static Lanes<2>::V low(V v) { return Lanes<2>::V{v[0], v[1]}; }
    static Lanes<2>::V high(V v) { return Lanes<2>::V{v[2], v[3]}; }
    static double sum(V v) { return Lanes<2>::sum(low(v) + high(v)); }
    static double largest(V v) { return Lanes<2>::largest(low(v) > high(v) ? low(v) : high(v)); }
};

// N vectors side by side; named members, because compilers keep those in registers.
template <int N>
struct Pack;

template <>
struct Pack<1> {
    static constexpr int size = Simd::width;
    Simd::V a;
    static Pack load(const double* p) { return {Simd::load(p)}; }
    // vector i from make(i); use(i, vector i)
    template <int first = 0, class Make>
    static Pack made(const Make& make) { return {make(first)}; }
    template <int first = 0, class Use>
    void each(const Use& use) const { use(first, a); }
    void store(double* p) const { Simd::store(p, a); }
    Simd::V folded() const { return a; }
};

template <int N>
struct Pack {
    static constexpr int size = N * Simd::width;
    static constexpr int half = N - N / 2;
    Pack<half> a;
    Pack<N / 2> b;
    static Pack load(const double* p) {
        return {Pack<half>::load(p), Pack<N / 2>::load(p + half * Simd::width)};
    }
    template <int first = 0, class Make>
    static Pack made(const Make& make) {
        return {Pack<half>::template made<first>(make), Pack<N / 2>::template made<first + half>(make)};
    }
    template <int first = 0, class Use>
    void each(const Use& use) const { a.template each<first>(use), b.template each<first + half>(use); }
    void store(double* p) const { a.store(p), b.store(p + half * Simd::width); }
    Simd::V folded() const { return a.folded() + b.folded(); }
};

// x * y + z and z - x * y; the compiler fuses them where the instruction set can
template <int N>
inline Pack<N> mul_add(const Pack<N>& x, const Pack<N>& y, const Pack<N>& z) {
    if constexpr (N == 1) return {x.a * y.a + z.a};
    else return {mul_add(x.a, y.a, z.a), mul_add(x.b, y.b, z.b)};
}
template <int N>
inline Pack<N> neg_mul_add(const Pack<N>& x, const Pack<N>& y, const Pack<N>& z) {
    if constexpr (N == 1) return {z.a - x.a * y.a};
    else return {neg_mul_add(x.a, y.a, z.a), neg_mul_add(x.b, y.b, z.b)};
}
// a b - c d with the first product fused: the second one is ready before b
template <int N>
inline Pack<N> recurred(const Pack<N>& a, const Pack<N>& b, const Pack<N>& c, const Pack<N>& d) {
    if constexpr (N == 1) {
        const Simd::V first = a.a * b.a;
        return {first - c.a * d.a};
    } else {
        return {recurred(a.a, b.a, c.a, d.a), recurred(a.b, b.b, c.b, d.b)};
    }
}
template <int N>
inline Pack<N> mul_add(const Pack<N>& x, double y, const Pack<N>& z) {
    if constexpr (N == 1) return {x.a * y + z.a};
    else return {mul_add(x.a, y, z.a), mul_add(x.b, y, z.b)};
}
// sum += x * y, all vectors into one
template <int N>
inline void add_products(Simd::V& sum, const Pack<N>& x, const Pack<N>& y) {
    if constexpr (N == 1) sum += x.a * y.a;
    else add_products(sum, x.a, y.a), add_products(sum, x.b, y.b);
}
// x * y + s and s - x * y for a scalar s
template <int N>
inline Pack<N> mul_plus(const Pack<N>& x, const Pack<N>& y, double s) {
    if constexpr (N == 1) return {x.a * y.a + s};
    else return {mul_plus(x.a, y.a, s), mul_plus(x.b, y.b, s)};
}
template <int N>
inline Pack<N> neg_mul_plus(const Pack<N>& x, const Pack<N>& y, double s) {
    if constexpr (N == 1) return {s - x.a * y.a};
    else return {neg_mul_plus(x.a, y.a, s), neg_mul_plus(x.b, y.b, s)};
}
template <int N>
inline Pack<N> operator*(const Pack<N>& x, const Pack<N>& y) {
    if constexpr (N == 1) return {x.a * y.a};
    else return {x.a * y.a, x.b * y.b};
}
template <int N>
inline Pack<N> operator*(const Pack<N>& x, double y) {
    if constexpr (N == 1) return {x.a * y};
    else return {x.a * y, x.b * y};
}
template <int N>
inline Pack<N> operator+(const Pack<N>& x, double y) {
    if constexpr (N == 1) return {x.a + y};
    else return {x.a + y, x.b + y};
}
template <int N>
inline Pack<N> operator-(double x, const Pack<N>& y) {
    if constexpr (N == 1) return {x - y.a};
    else return {x - y.a, x - y.b};
}
template <int N>
inline Pack<N> operator+(const Pack<N>& x, const Pack<N>& y) {
    if constexpr (N == 1) return {x.a + y.a};
    else return {x.a + y.a, x.b + y.b};
}
template <int N>
inline Pack<N> operator-(const Pack<N>& x, const Pack<N>& y) {
    if constexpr (N == 1) return {x.a - y.a};
    else return {x.a - y.a, x.b - y.b};
}

}  // namespace
}  // namespace tonewood
