// Steps a system saved by saved.py with the kernel alone and compares with the samples saved beside it.
//     compare TOLERANCE FILE...
// prints for each file "samples  peak  largest difference / peak"; exit code 1 where the last is above TOLERANCE.
#include <cstdio>

#include "saved_model.hpp"

namespace {

bool same(const char* path, double tolerance) {
    tonewood::saved::SavedModel model(path, "baseline");
    const auto& wanted = model.file()["samples"];
    std::vector<double> out(wanted.f8.size());
    model.add("injections");
    model.process(out.data(), wanted.shape[0]);
    double peak = 0, off = 0;
    for (std::size_t i = 0; i < out.size(); ++i) {
        peak = std::max(peak, std::abs(wanted.f8[i]));
        off = std::max(off, std::abs(out[i] - wanted.f8[i]));
    }
    std::printf("%zu %.3e %.3e\n", wanted.shape[0], peak, off / peak);
    return peak > 0 && off <= tolerance * peak;
}

}  // namespace

int main(int count, char** paths) {
    bool good = count > 2;
    for (int i = 2; i < count; ++i) good = same(paths[i], std::stod(paths[1])) && good;
    return good ? 0 : 1;
}
