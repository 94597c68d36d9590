// Computes a Faust processor for argv[1] seconds at 48 kHz, prints the processor's time and the rms of the sound.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <vector>

#include "faust/dsp/dsp.h"
#include "faust/gui/UI.h"
#include "faust/gui/meta.h"
#include "modes.hpp"

int main(int, char** argv) {
    const int block = 256, n = int(48000 * std::atof(argv[1])) / block;
    mydsp processor;
    processor.init(48000);
    std::vector<FAUSTFLOAT> in(block, 0), out(block);
    FAUSTFLOAT *ins[] = {in.data()}, *outs[] = {out.data()};
    double sum = 0;
    const std::clock_t began = std::clock();
    for (int i = 0; i < n; i++) {
        in[0] = i == 0 ? 1 : 0;
        processor.compute(block, ins, outs);
        for (double y : out) sum += y * y;
    }
    std::printf("%.6f %g\n", double(std::clock() - began) / CLOCKS_PER_SEC, std::sqrt(sum / (n * block)));
}
