// Loads a saved instrument, plucks its strings one after the other, and writes the sound to a WAV file.
//     pluck MODEL.tonewood OUT.wav [SECONDS]
// The model is that of tonewood.sound.render.model_file.save_model; no Python takes part. Build: CMakeLists.txt beside this.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <fstream>

#include "saved_model.hpp"

namespace {

void write_number(std::ofstream& stream, std::uint32_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) stream.put(char(value >> (8 * i) & 0xff));
}

// 16 bits, the largest sample at -1 dBFS.
void write_wav(const std::string& path, const std::vector<double>& sound, int n_channels, int fs) {
    double peak = 1e-30;
    for (const double x : sound) {
        if (!std::isfinite(x)) throw std::runtime_error("the sound is not finite");
        peak = std::max(peak, std::abs(x));
    }
    const std::uint32_t n_bytes = std::uint32_t(2 * sound.size());
    std::ofstream stream(path, std::ios::binary);
    stream << "RIFF", write_number(stream, 36 + n_bytes, 4), stream << "WAVEfmt ";
    write_number(stream, 16, 4), write_number(stream, 1, 2), write_number(stream, std::uint32_t(n_channels), 2);
    write_number(stream, std::uint32_t(fs), 4), write_number(stream, std::uint32_t(2.0 * n_channels * fs), 4);
    write_number(stream, std::uint32_t(2 * n_channels), 2), write_number(stream, 16, 2);
    stream << "data", write_number(stream, n_bytes, 4);
    for (const double x : sound) write_number(stream, std::uint32_t(std::int32_t(std::lround(x / peak * 29203))), 2);
    if (!stream) throw std::runtime_error(path + " cannot be written");
}

}  // namespace

int main(int count, char** arguments) try {
    if (count < 3) throw std::runtime_error("usage: pluck MODEL.tonewood OUT.wav [SECONDS]");
    tonewood::saved::SavedModel model(arguments[1]);
    const int fs = int(std::lround(model.fs())), n_channels = model.n_channels();
    const double seconds = count > 3 ? std::stod(arguments[3]) : 4.0;
    if (!(seconds > 0 && seconds < 600)) throw std::runtime_error("0 to 600 s are allowed");
    // a host's callback: blocks of 64 samples, events between two of them
    constexpr std::size_t kBlock = 64;
    const std::size_t n_blocks = std::size_t(seconds * fs) / kBlock + 1;
    const std::size_t apart = std::max<std::size_t>(1, std::size_t(0.25 * fs) / kBlock);
    const std::vector<double>& scale = model.scale();
    constexpr std::size_t kMost = std::size_t(1) << 28;  // samples of the file; its sizes have 32 bits
    if (n_channels == 0 || n_blocks > kMost / kBlock / std::size_t(n_channels))
        throw std::runtime_error("no channels, or a sound of more than " + std::to_string(kMost) + " samples");
    std::vector<double> sound(n_blocks * kBlock * std::size_t(n_channels));
    std::chrono::duration<double> longest{};
    const auto began = std::chrono::steady_clock::now();
    for (std::size_t block = 0; block < n_blocks; ++block) {
        const auto before = std::chrono::steady_clock::now();
        if (block % apart == 0 && block / apart < model.n_plucks()) model.pluck(block / apart);
        double* const out = sound.data() + block * kBlock * std::size_t(n_channels);
        model.process(out, kBlock);
        for (std::size_t i = 0; i < kBlock * std::size_t(n_channels); ++i) out[i] *= scale[i % std::size_t(n_channels)];
        longest = std::max(longest, std::chrono::duration<double>(std::chrono::steady_clock::now() - before));
    }
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began;
    write_wav(arguments[2], sound, n_channels, fs);
    std::printf("%zu strings, %.1f x real time, longest block %.0f us of %.0f us\n", model.n_plucks(),
                double(n_blocks * kBlock) / fs / took.count(), 1e6 * longest.count(), 1e6 * kBlock / fs);
} catch (const std::exception& error) {
    std::fprintf(stderr, "pluck: %s\n", error.what());
    return 2;
}
