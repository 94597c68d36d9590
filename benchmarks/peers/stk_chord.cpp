// Six stiff Karplus-Strong strings of STK for argv[1] seconds at 48 kHz; prints the processor's time and the rms.
#include <stk/StifKarp.h>
#include <stk/Stk.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

int main(int, char** argv) {
    stk::Stk::setSampleRate(48000.0);
    const double notes[] = {82.41, 110.0, 146.83, 196.0, 246.94, 329.63};
    std::vector<std::unique_ptr<stk::StifKarp>> strings;
    for (double freq : notes) {
        strings.push_back(std::make_unique<stk::StifKarp>(60.0));
        strings.back()->noteOn(freq, 0.8);
    }
    const long n = long(48000 * std::atof(argv[1]));
    double sum = 0;
    const std::clock_t began = std::clock();
    for (long i = 0; i < n; i++) {
        double y = 0;
        for (auto& string : strings) y += string->tick();
        sum += y * y;
    }
    std::printf("%.6f %g\n", double(std::clock() - began) / CLOCKS_PER_SEC, std::sqrt(sum / n));
}
