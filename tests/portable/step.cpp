// Steps a system saved by saved.py with the kernel alone and compares with the samples saved beside it.
//     step TOLERANCE FILE...
// prints for each file "samples  peak  largest difference / peak"; exit code 1 where the last is above TOLERANCE.
#include <cstdio>

#include "module.cpp"  // of the kernel, its bindings left out by nanobind_stand_in.hpp
#include "saved.hpp"

namespace tonewood {
namespace {

In in(const saved::File& file, const std::string& name) { return {file[name].f8.data(), file[name].shape}; }

std::string at(const char* what, std::size_t i, const char* of = "") {
    return std::string(what) + "/" + std::to_string(i) + of;
}

Kernel load(const saved::File& file) {
    const auto sizes = file.ints("kernel");
    Kernel kernel("baseline", sizes[0], sizes[1], sizes[2]);
    for (int i = 0; i < sizes[0]; ++i) {
        const auto a = [&](const char* of) { return in(file, at("component", i, of)); };
        const auto numbers = file.ints(at("component", i, "/numbers"));
        kernel.set_component(i, numbers[0], numbers[1], a("/e"), a("/rows"), a("/w"), a("/history"), a("/incidence"),
                             file.ints(at("component", i, "/channels")), file.ints(at("component", i, "/difference")));
        const auto g = [&](const char* of) { return in(file, at("guarded", i, of)); };
        if (file.has(at("guarded", i, "/w")))
            kernel.set_guarded(i, g("/e"), g("/rows"), g("/w"), g("/from_fixed"), g("/from_guarded"), g("/on_rows"));
        const auto s = [&](const char* of) { return in(file, at("stretched", i, of)); };
        if (file.has(at("stretched", i, "/a")))
            kernel.set_stretched(i, s("/a"), s("/half"), s("/reading"), s("/kick"), s("/e"));
    }
    std::vector<std::tuple<double, bool, std::vector<GeometricArrays>>> along;
    for (std::size_t t = 0; file.has(at("geometric", t)); ++t) {
        const auto& numbers = file[at("geometric", t)].f8;
        std::vector<GeometricArrays> parts;
        for (std::size_t p = 0; p + 2 < numbers.size(); ++p) {
            const auto a = [&](const char* of) { return in(file, at("geometric", t, ("/" + std::to_string(p) + of).c_str())); };
            parts.emplace_back(int(numbers[2 + p]), a("/slopes"), a("/reading"), a("/yields"), a("/kick"), a("/to_port"),
                               a("/from_port"));
        }
        along.emplace_back(numbers[0], numbers[1] != 0.0, std::move(parts));
    }
    if (!along.empty()) kernel.set_geometric(along);
    kernel.set_solve(in(file, "solve/g"), in(file, "solve/gamma"), in(file, "solve/constant"), in(file, "solve/weights"));
    const auto& numbers = file["nonlinear/numbers"].f8;
    std::vector<std::tuple<int, int, int, bool, double>> terms;
    const auto& term = file["nonlinear/terms"].f8;
    for (std::size_t i = 0; i < term.size(); i += 5)
        terms.emplace_back(int(term[i]), int(term[i + 1]), int(term[i + 2]), term[i + 3] != 0.0, term[i + 4]);
    kernel.set_nonlinear(std::size_t(numbers[0]), terms, numbers[1], numbers[2], numbers[3] != 0.0, in(file, "nonlinear/weights"));
    std::vector<std::pair<int, LawArrays>> laws;
    for (std::size_t j = 0; file.has(at("law", j)); ++j) {
        const auto& law = file[at("law", j)].f8;
        LawArrays arrays;
        std::get<0>(arrays) = int(law[0]), std::get<1>(arrays).assign(law.begin() + 1, law.end());
        std::get<2>(arrays) = file[at("law", j, "/knots")].f8, std::get<3>(arrays) = file[at("law", j, "/coefficients")].f8;
        laws.emplace_back(int(j), std::move(arrays));
    }
    kernel.set_laws(laws);
    if (file.has("gaps/compliance"))
        kernel.set_gaps(in(file, "gaps/compliance"), in(file, "gaps/from_linear"), in(file, "gaps/to_linear"), in(file, "gaps/residual"));
    if (file.has("tensions/matrix")) {
        std::vector<std::tuple<int, double, std::vector<int>>> strings;
        for (std::size_t t = 0; file.has(at("tension", t)); ++t)
            strings.emplace_back(int(file[at("tension", t)].f8[0]), file[at("tension", t)].f8[1], file.ints(at("tension", t, "/components")));
        kernel.set_tensions(strings, in(file, "tensions/matrix"), in(file, "tensions/offset"));
    }
    return kernel;
}

bool same(const char* path, double tolerance) {
    const saved::File file(path);
    Kernel kernel = load(file);
    const auto& wanted = file["samples"];
    const std::size_t n = wanted.shape[0], capacity = file.ints("kernel")[1], m = file["solve/gamma"].f8.size();
    const std::size_t k = std::size_t(file["nonlinear/numbers"].f8[0]), tensions = std::size_t(file.ints("kernel")[3]);
    std::vector<double> modes(2 * capacity), out(wanted.f8.size()), forces(n * m), law_forces(n * k), series(k), slip(k),
        last(k), tension(3 * tensions);
    std::vector<std::tuple<int, std::int64_t, In, In>> injections;
    for (std::size_t i = 0; file.has(at("injection", i)); ++i)
        injections.emplace_back(file.ints(at("injection", i))[0], file[at("injection", i)].i8[1],
                                in(file, at("injection", i, "/vectors")), in(file, at("injection", i, "/values")));
    const auto fault = kernel.run({modes.data(), {2, capacity}}, {out.data(), wanted.shape}, {forces.data(), {n, m}},
                                  injections, {law_forces.data(), {n, k}}, {}, {series.data(), {k}}, {slip.data(), {k}},
                                  {last.data(), {k}}, {tension.data(), {tensions, 3}});
    double peak = 0, off = 0;
    for (std::size_t i = 0; i < out.size(); ++i) {
        peak = std::max(peak, std::abs(wanted.f8[i]));
        off = std::max(off, std::abs(out[i] - wanted.f8[i]));
    }
    std::printf("%zu %.3e %.3e\n", n, peak, off / peak);
    return fault.first == -1 && peak > 0 && off <= tolerance * peak;
}

}  // namespace
}  // namespace tonewood

int main(int count, char** paths) {
    bool good = count > 2;
    for (int i = 2; i < count; ++i) good = tonewood::same(paths[i], std::stod(paths[1])) && good;
    return good ? 0 : 1;
}
