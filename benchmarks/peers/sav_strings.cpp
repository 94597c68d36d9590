// Six strings of IRCAM's SAV-string-simulations (StringProcessor.h, its Eigen version): argv[1] seconds, argv[2]
// 0 linear, 1 Kirchhoff-Carrier, 2 geometrically exact to fourth order; f0 in Hz and beta of each string from argv[4] on.
// Each is pushed by argv[3] N at a fifth of its length for 1.5 ms (a parabola in time). Prints the processor's time and
// the rms near the end. With TRACE set, the first string's displacement there goes to this file as 32-bit floats.
// At 48 kHz, or at RATE.
#include <StringProcessor.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

int main(int argc, char** argv) {
    const double rate = std::getenv("RATE") ? std::atof(std::getenv("RATE")) : 48000, pulse = 1.5e-3;
    const long n = long(rate * std::atof(argv[1]));
    const double force = std::atof(argv[3]);
    std::vector<std::unique_ptr<StringProcessor<double>>> strings;
    for (int i = 4; i + 1 < argc; i += 2) {
        auto s = std::make_unique<StringProcessor<double>>(float(rate));
        s->f0 = std::atof(argv[i]), s->beta = std::atof(argv[i + 1]);
        s->t60_0 = s->t60_1 = 3 * std::log(10.0) / 0.5;
        s->nonlinear_mode = NLMODE(std::atoi(argv[2]));
        s->reinitDsp(float(rate));
        strings.push_back(std::move(s));
    }
    std::FILE* const trace = std::getenv("TRACE") ? std::fopen(std::getenv("TRACE"), "wb") : nullptr;
    double sum = 0;
    const std::clock_t began = std::clock();
    for (auto& s : strings) {
        const int points = s->getN();
        const double at = (0.2 * points - 1) / (points - 2), read = (0.9 * points - 1) / (points - 2);
        for (long k = 0; k < n; ++k) {
            const double t = k / rate;
            const auto [left, right, apart] = s->process(t < pulse ? 4 * force * (t / pulse) * (1 - t / pulse) : 0, 0, at, read, read);
            sum += left * left;
            if (trace && s == strings.front()) {
                const float y = s->getState()[std::size_t(std::lround(0.9 * points)) - 1];
                std::fwrite(&y, sizeof y, 1, trace);
            }
        }
    }
    const double took = double(std::clock() - began) / CLOCKS_PER_SEC;
    if (trace) std::fclose(trace);
    for (auto& s : strings) std::fprintf(stderr, "%d ", s->getN());
    std::printf("%.6f %g\n", took, std::sqrt(sum / n));
}
