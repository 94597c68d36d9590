// Damages saved models and loads and plays what comes of them: every damaged file gives samples or one line.
//     mutate COUNT SEED FILE...
// prints "mutations played refused"; exit code 1 and the damaged file in ./damaged.tonewood where an error has another
// form or a call takes more than 20 s of processor. Built with sanitizers (tests/portable/test_damaged_models.py). With
// -fsanitize=fuzzer -DTONEWOOD_LIBFUZZER it is a target of libFuzzer, FILE... being its corpus.
//
// A mutation changes numbers, shapes, names and types of the arrays, of several with the same length together, and
// puts offsets and capacity right again most of the time: so what is behind the first checks is reached as well.
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <random>
#include <sstream>

#include "saved_model.hpp"

namespace {

using Random = std::mt19937_64;

struct Raw {
    std::string name, type;
    std::vector<std::uint64_t> shape;
    std::string bytes;
    std::size_t size() const { return bytes.size() / 8; }
    std::int64_t integer() const {
        std::int64_t x = 0;
        if (bytes.size() == 8) std::memcpy(&x, bytes.data(), 8);
        return x;
    }
};
using Arrays = std::vector<Raw>;

const std::string kMagic = "tonewood-arrays/1\n";

// Arrays of a file; fewer where it is damaged.
Arrays parsed(const std::string& file) {
    Arrays out;
    for (std::size_t at = std::min(kMagic.size(), file.size()); at < file.size();) {
        const std::size_t end = file.find('\n', at);
        if (end == std::string::npos) break;
        std::istringstream words(file.substr(at, end - at));
        Raw raw;
        std::uint64_t n, size = 1;
        words >> raw.name >> raw.type;
        while (words >> n) raw.shape.push_back(n), size = n && size > file.size() / n ? file.size() : size * n;
        if (size > (file.size() - end - 1) / 8) break;
        raw.bytes = file.substr(end + 1, 8 * size);
        at = end + 1 + 8 * size;
        out.push_back(std::move(raw));
    }
    return out;
}

std::string written(const Arrays& arrays) {
    std::string out = kMagic;
    for (const Raw& raw : arrays) {
        out += raw.name + " " + raw.type;
        for (const std::uint64_t n : raw.shape) out += " " + std::to_string(n);
        out += "\n" + raw.bytes;
    }
    return out;
}

class Mutation {
public:
    explicit Mutation(std::uint64_t seed) : random_(seed) {}

    std::string operator()(Arrays arrays) {
        const int steps = 1 + int(below(4)) * int(below(2));
        for (int i = 0; i < steps && !arrays.empty(); ++i) step(arrays);
        if (below(10) < 7) mend(arrays);
        std::string out = written(arrays);
        if (below(20) == 0) scratch(out);
        return out;
    }

private:
    std::uint64_t below(std::uint64_t n) { return n ? random_() % n : 0; }
    template <class T>
    T one_of(std::initializer_list<T> values) { return values.begin()[below(values.size())]; }

    void step(Arrays& arrays) {
        Raw& raw = arrays[below(arrays.size())];
        const std::uint64_t what = below(100);
        if (what < 30) change_number(arrays, raw.type == "i8" || below(3) ? raw : any_integer(arrays));
        else if (what < 38) scale(raw);
        else if (what < 48) reshape(raw);
        else if (what < 66) relength(arrays, raw);
        else if (what < 72) arrays.erase(arrays.begin() + (&raw - arrays.data()));
        else if (what < 76) raw.type = raw.type == "f8" ? "i8" : "f8";
        else if (what < 80) std::reverse(raw.shape.begin(), raw.shape.end());
        else if (what < 84) retype(raw);
        else if (what < 89) rename(raw.name);
        else if (what < 92) arrays.push_back(raw);
        else if (what < 96) swap(arrays, raw);
        else drop_group(arrays, raw.name);
    }
    Raw& any_integer(Arrays& arrays) {
        for (int tries = 0; tries < 20; ++tries)
            if (Raw& raw = arrays[below(arrays.size())]; raw.type == "i8") return raw;
        return arrays.front();
    }
    void change_number(const Arrays& arrays, Raw& raw) {
        if (raw.size() == 0) return;
        char* const at = raw.bytes.data() + 8 * below(raw.size());
        if (raw.type == "i8") {
            std::int64_t x;
            std::memcpy(&x, at, 8);
            const std::int64_t far = std::numeric_limits<std::int64_t>::min(), near = 1 << 30;
            const std::int64_t y = one_of<std::int64_t>(
                {-1, 0, 1, 2, 3, 7, 16, 32, 100, 1 << 20, 1LL << 31, (1LL << 31) - 1, 1LL << 40, 1LL << 62, far, ~far,
                 std::int64_t(arrays.size()), std::int64_t(below(50)), std::int64_t(below(50))});
            x = below(3) == 0 ? x + one_of<std::int64_t>({-16, -1, 1, 16}) * (-near < x && x < near) : y;
            std::memcpy(at, &x, 8);
        } else {
            double x;
            std::memcpy(&x, at, 8);
            const double far = std::numeric_limits<double>::max();
            x = one_of<double>({0.0, -0.0, 1.0, -1.0, 1e300, -1e300, far, 1e-310, 1e-30, 1e10, 1e18, -x, 2 * x, x / 2, 1e6 * x,
                                std::nan(""), HUGE_VAL, double(below(100))});
            std::memcpy(at, &x, 8);
        }
    }
    void scale(Raw& raw) {
        const double by = one_of<double>({0.0, -1.0, 1e-9, 1e3, 1e9, 1e150, 0.999, 1.001});
        for (std::size_t i = 0; raw.type == "f8" && i < raw.size(); ++i) {
            double x;
            std::memcpy(&x, raw.bytes.data() + 8 * i, 8);
            x = x * by;
            std::memcpy(raw.bytes.data() + 8 * i, &x, 8);
        }
    }
    std::uint64_t another(std::uint64_t n) {
        return one_of<std::uint64_t>({0, 1, 2, 3, n + 1, n + 16, n + 32, 2 * n, n > 0 ? n - 1 : 0, n > 16 ? n - 16 : n});
    }
    // The bytes that its shape needs, those there are repeated.
    static void fit(Raw& raw) {
        std::uint64_t size = 1;
        for (const std::uint64_t n : raw.shape) size = std::min<std::uint64_t>(size * std::min<std::uint64_t>(n, 1 << 20), 1 << 20);
        const std::string old = raw.bytes.empty() ? std::string(8, '\0') : raw.bytes;
        raw.bytes.resize(8 * size);
        for (std::size_t i = 0; i < raw.bytes.size(); ++i) raw.bytes[i] = old[i % old.size()];
    }
    void reshape(Raw& raw) {
        if (raw.shape.empty() || below(8) == 0) raw.shape.push_back(another(1));
        else if (below(8) == 0) raw.shape.pop_back();
        else raw.shape[below(raw.shape.size())] = another(raw.shape[below(raw.shape.size())]);
        fit(raw);
    }
    // Another length wherever this one stands: in the folder of `raw`, its part of the model, or everywhere.
    void relength(Arrays& arrays, const Raw& raw) {
        if (raw.shape.empty()) return;
        const std::uint64_t from = raw.shape[below(raw.shape.size())], to = another(from);
        std::string scope = raw.name.substr(0, raw.name.rfind('/') + 1);
        if (below(3) == 0) scope = scope.substr(0, scope.find('/') + 1);
        if (below(3) == 0) scope.clear();
        const bool first_only = below(2), last_only = !first_only && below(2);
        for (Raw& other : arrays) {
            if (!other.name.starts_with(scope)) continue;
            bool changed = false;
            for (std::size_t i = 0; i < other.shape.size(); ++i)
                if (other.shape[i] == from && !(first_only && i > 0) && !(last_only && i + 1 < other.shape.size()))
                    other.shape[i] = to, changed = true;
            if (changed) fit(other);
        }
    }
    void retype(Raw& raw) {
        if (below(2)) raw.type = one_of<const char*>({"f8", "i8", "f4", "", "i8i8", "f8 ", "i8 -1", "f8 1.0", "i8 +1"});
        else raw.shape.assign(one_of<std::size_t>({2, 3, 5, 40}),
                              one_of<std::uint64_t>({1, 1ULL << 31, 1ULL << 32, 1ULL << 61, ~0ULL, 0}));
    }
    void rename(std::string& name) {
        if (const std::size_t at = name.find_first_of("0123456789"); at != std::string::npos && below(3))
            name[at] = char('0' + below(10));
        else
            name = one_of<std::string>({"", "x", "linear/inverse", "components/1/contact_rows", "potentials/0/at",
                                        "linear/parts/0/places", std::string(400, 'n'), name + "\t", name + "/0/0"});
    }
    void swap(Arrays& arrays, Raw& raw) {
        std::vector<Raw*> same;
        for (Raw& other : arrays)
            if (other.type == raw.type && other.bytes.size() == raw.bytes.size()) same.push_back(&other);
        std::swap(raw.bytes, same[below(same.size())]->bytes);
    }
    void drop_group(Arrays& arrays, const std::string& name) {
        const std::string folder = name.substr(0, name.rfind('/') + 1);
        if (!folder.empty()) std::erase_if(arrays, [&](const Raw& raw) { return raw.name.starts_with(folder); });
    }
    // Damages that know nothing of the format.
    void scratch(std::string& file) {
        if (below(3) == 0) file.resize(below(file.size() + 1));
        for (std::uint64_t i = below(6); i > 0 && !file.empty(); --i) file[below(file.size())] = char(below(256));
    }
    static void set(Raw& raw, std::int64_t x) { std::memcpy(raw.bytes.data(), &x, 8); }
    // Puts offsets and capacity right.
    static void mend(Arrays& arrays) {
        const auto find = [&](const std::string& name) -> Raw* {
            for (Raw& raw : arrays)
                if (raw.name == name) return &raw;
            return nullptr;
        };
        std::int64_t modes = 0;
        for (int i = 0;; ++i) {
            const std::string at = "components/" + std::to_string(i) + "/";
            Raw *offset = find(at + "offset"), *e = find(at + "e");
            if (!offset || !e || offset->bytes.size() != 8 || e->shape.size() != 2) break;
            set(*offset, modes), modes += std::int64_t(e->shape[1]);
        }
        if (Raw* capacity = find("capacity"); capacity && capacity->bytes.size() == 8) set(*capacity, modes);
    }

    Random random_;
};

// Empty where a file could be played, else the error; throws where an error is not of the promised kind, or samples are not finite.
std::string refusal(const std::string& bytes) {
    constexpr std::size_t n = 100;
    std::string reason;
    try {
        std::istringstream stream(bytes);
        tonewood::saved::SavedModel model(tonewood::saved::File(stream, "f"), "baseline");
        if (model.file().has("fs")) (void)model.fs(), (void)model.scale();
        for (std::size_t i = 0; i < std::min<std::size_t>(model.n_plucks(), 6); ++i) model.pluck(i);
        model.add("injections");
        std::vector<double> out(n * std::size_t(model.n_channels()));
        for (int i = 0; i < 2; ++i) model.process(out.data(), n);
        for (const double x : out)
            if (!std::isfinite(x)) throw std::logic_error("samples are not finite");
        return "";
    } catch (const std::runtime_error& error) {
        reason = error.what();
    }
    if (reason.empty() || reason.size() > 1000 ||
        std::any_of(reason.begin(), reason.end(), [](char c) { return c < ' ' || c > '~'; }))
        throw std::logic_error("an error is no line of text");
    return reason;
}

}  // namespace

#ifdef TONEWOOD_LIBFUZZER

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    refusal(std::string(reinterpret_cast<const char*>(data), size));
    return 0;
}

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t most, unsigned seed) {
    const std::string out = Mutation(seed)(parsed(std::string(reinterpret_cast<const char*>(data), size)));
    std::memcpy(data, out.data(), std::min(out.size(), most));
    return std::min(out.size(), most);
}

#else

// of the sanitizers' runtime; without them there is none
extern "C" __attribute__((weak)) void __sanitizer_set_death_callback(void (*call)());

namespace {

std::string content(const char* path) {
    std::ifstream stream(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
}

std::string damaged;  // the file that is read now

void keep_damaged() { std::ofstream("damaged.tonewood", std::ios::binary) << damaged; }

}  // namespace

int main(int count, char** arguments) {
    const std::uint64_t n = count > 3 ? std::stoull(arguments[1]) : 0, seed = count > 3 ? std::stoull(arguments[2]) : 0;
    std::vector<Arrays> files;
    for (int i = 3; i < count; ++i) {
        files.push_back(parsed(content(arguments[i])));
        const std::string reason = refusal(content(arguments[i]));
        if (!reason.empty() || written(files.back()) != content(arguments[i])) {
            std::fprintf(stderr, "%s: %s\n", arguments[i], reason.c_str());
            return 1;
        }
    }
    if (files.empty()) return 1;
    if (__sanitizer_set_death_callback) __sanitizer_set_death_callback(keep_damaged);
    std::signal(SIGVTALRM, [](int) {
        keep_damaged();
        std::fprintf(stderr, "more than 20 s of processor\n");
        _exit(1);
    });
    const itimerval limit{{0, 0}, {20, 0}};
    std::uint64_t played = 0;
    for (std::uint64_t i = 0; i < n; ++i) {
        damaged = Mutation(seed + i)(files[i % files.size()]);
        try {
            setitimer(ITIMER_VIRTUAL, &limit, nullptr);
            played += refusal(damaged).empty();
        } catch (const std::exception& error) {
            keep_damaged();
            std::fprintf(stderr, "mutation %llu: %s\n", (unsigned long long)(seed + i), error.what());
            return 1;
        }
    }
    std::printf("%llu %llu %llu\n", (unsigned long long)n, (unsigned long long)played, (unsigned long long)(n - played));
}

#endif
