// Compiled once per instruction set, with TONEWOOD_ISA_NAME and TONEWOOD_ISA_TABLE set by the build.
#include <chrono>

#include "run.hpp"

namespace tonewood {
namespace {

double fma_peak(double seconds) {
    using V = Simd<double>::V;
    using Clock = std::chrono::steady_clock;
    V a[12];
    for (int i = 0; i < 12; ++i)
        for (int k = 0; k < Simd<double>::width; ++k) a[i][k] = 1.0 + 0.01 * (i + k);
    V m, s;
    for (int k = 0; k < Simd<double>::width; ++k) m[k] = 0.999, s[k] = 0.001;
    const auto start = Clock::now();
    double count = 0, elapsed = 0;
    do {
        for (int r = 0; r < 10000; ++r) {
            for (int i = 0; i < 12; ++i) a[i] = a[i] * m + s;
            asm volatile("" : "+m"(m));
        }
        count += 10000.0 * 12 * Simd<double>::width;
        elapsed = std::chrono::duration<double>(Clock::now() - start).count();
    } while (elapsed < seconds);
    double keep = 0;
    for (auto& v : a) keep += sum<double>(v);
    return keep == 12345.0 ? 0.0 : count / elapsed;
}

}  // namespace

extern const Table TONEWOOD_ISA_TABLE;
const Table TONEWOOD_ISA_TABLE = {TONEWOOD_ISA_NAME, &run<double>, &run<float>, &fma_peak};

}  // namespace tonewood
