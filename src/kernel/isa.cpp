// Compiled once per instruction set, with TONEWOOD_ISA_NAME and TONEWOOD_ISA_TABLE set by the build.
#include <chrono>

#include "step.hpp"

namespace tonewood {
namespace {

double fma_peak(double seconds) {
    using P = Pack<kPack>;
    using Clock = std::chrono::steady_clock;
    double numbers[P::size];
    for (int i = 0; i < P::size; ++i) numbers[i] = 1.0 + 0.01 * i;
    P a = P::load(numbers), b = a, c = a, d = a;  // enough chains to hide the latency of both multiply-add units
    const P m = P::load(numbers);
    const auto start = Clock::now();
    double count = 0, elapsed = 0;
    do {
        for (int r = 0; r < 10000; ++r) {
            a = mul_plus(a, m, 0.001);
            b = mul_plus(b, m, 0.002);
            c = mul_plus(c, m, 0.003);
            d = mul_plus(d, m, 0.004);
        }
        count += 10000.0 * 4 * P::size;
        elapsed = std::chrono::duration<double>(Clock::now() - start).count();
    } while (elapsed < seconds);
    (a + b + (c + d)).store(numbers);
    double sum = 0.0;  // of every lane: the compiler leaves out sums that are not used
    for (const double x : numbers) sum += x;
    return sum == 12345.0 ? 0.0 : count / elapsed;
}

}  // namespace

extern const Table TONEWOOD_ISA_TABLE;
const Table TONEWOOD_ISA_TABLE = {TONEWOOD_ISA_NAME, &run, &fma_peak};

}  // namespace tonewood
