// Strings with longitudinal motion: their direction is the gradient of U; the equations are in
// tonewood.coupling.potentials.longitudinal.
#pragma once

#include "modal_forces.hpp"

namespace tonewood {
namespace {

constexpr double kLeastShift = 1e-8;  // part of EA L by which C exceeds the energy of a string

class StretchedStrings final : public ModalForces {
public:
    StretchedStrings(PotentialRun& run, int first, int end) : ModalForces(run, first, end) {
        for (int s = first_; s < end_; ++s) {
            String string{t_.stretches[t_.two_way[s].data]};
            for (std::size_t q = 0; q < string.given.parts.size(); ++q) {
                const auto& g = string.given.parts[q];
                string.parts.push_back(&add_part(s, q, g.n));
                string.slopes.emplace_back();
                for (Array<double>& a : string.slopes.back())
                    a.assign(g.cosines_width + 2 * string.given.order + kLane, 0.0);
            }
            const std::size_t order = padded(string.given.order + 1);
            for (Array<double>* a : {&string.squares, &string.strain, &string.tension, &string.stretching})
                a->assign(order, 0.0);
            std::size_t most = 0;
            for (const auto& g : string.given.parts) most = std::max(most, std::size_t(g.cosines_width));
            string.on_cosines.assign(most, 0.0);
            strings_.push_back(std::move(string));
            const double* const kept = row(s);
            const double stored = potential(s) + kept[3];
            double& C = at(s).shift = std::abs(kept[1]);
            if (!(C > 0.0 && stored + C > 0.0)) C = shift(s, stored);
            ws_.psi[s] = std::copysign(std::sqrt(2 * (stored + C)), kept[1]);
            ws_.past[0][s] = kept[0];
        }
    }

    bool pull() override {
        for (int s = first_; s < end_; ++s) stretch(s);
        return true;
    }

    void direct() override {
        for (int s = first_; s < end_; ++s) strain(s), direct(s);
    }

    void end_step() override {
        for (int s = first_; s < end_; ++s) {
            ws_.past[0][s] = at(s).per_mean * ws_.mean[s];
            make_forces(s, at(s).parts);
        }
    }

    // Puts V back to U where it `resets`, and chooses C anew.
    void keep(int s, bool resets) override {
        String& string = at(s);
        double excess = 0.5 * ws_.psi[s] * ws_.psi[s] - string.shift - potential(s);
        if (resets) {
            excess += pay(string.parts, -excess);
            const double stored = potential(s) + excess;
            string.shift = shift(s, stored);
            ws_.psi[s] = std::sqrt(2 * (stored + string.shift));
        }
        row(s)[0] = ws_.past[0][s], row(s)[1] = std::copysign(string.shift, ws_.psi[s]), row(s)[2] = 0.0,
        row(s)[3] = excess;
    }

private:
    struct String {
        const Stretch& given;
        std::vector<Part*> parts{};  // the longitudinal one last
        // by part: cosines of `here`, `free` and their mean; halved but for the first, even
        std::vector<std::array<Array<double>, 3>> slopes{};
        double shift = 0, per_mean = 0;                              // C; mean tension per psi_m
        Array<double> squares{}, strain{}, tension{}, stretching{};  // s_n, l_n, forces on e_n and on l_n
        Array<double> on_cosines{};
    };

    String& at(int s) { return strings_[std::size_t(s - first_)]; }
    const String& at(int s) const { return strings_[std::size_t(s - first_)]; }
    static std::size_t transverse(const String& s) { return s.parts.size() - 1; }

    // s_n of the step, and the displacements of the ports by the longitudinal modes under it.
    void stretch(int s) {
        String& string = at(s);
        const int order = string.given.order;
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        for (std::size_t q = 0; q < transverse(string); ++q) {
            Part& part = *string.parts[q];
            coordinates(part, ws_.driven.data() + part.modes.part->first_port);
            add_squares(string, q, 0.5, part.here, part.free);
        }
        for (int n = 0; n <= order; ++n) string.stretching[n] = weight(string, n) * string.squares[n];
        Part& part = *string.parts.back();
        const auto& g = string.given.parts.back();
        std::fill(part.force.begin(), part.force.end(), 0.0);
        add_product(g.back.data(), g.width, string.stretching.data(), order + 1, part.force.data());
        for (std::size_t k = 0; k < part.force.size(); k += S::width)
            S::store(part.force.data() + k, S::load(part.force.data() + k) * S::load(part.scale.data() + k) * -1.0);
        ports(part, part.force.data(), [&](int port, double moved) { ws_.pulled[port] = moved; });
    }

    // l_n: the mean strain over the step.
    void strain(int s) {
        String& string = at(s);
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        Part& part = *string.parts.back();
        const auto& g = string.given.parts.back();
        coordinates(part, ws_.answered.data() + part.modes.part->first_port);
        for (std::size_t k = 0; k < part.here.size(); k += S::width)
            S::store(part.free.data() + k, (S::load(part.here.data() + k) + S::load(part.free.data() + k) +
                                            S::load(part.force.data() + k) * S::load(part.scale.data() + k)) * 0.5);
        add_product(g.slopes.data(), g.cosines_width, part.free.data(), g.n, string.strain.data());
    }

    void direct(int s) {
        String& string = at(s);
        const int order = string.given.order;
        double stored = 0.0;
        for (int n = 0; n <= order; ++n) {
            const double square = string.squares[n], w = weight(string, n);
            stored += w * square * (0.5 * square + string.strain[n]);
            string.tension[n] = w * (square + string.strain[n]);
        }
        const double size = std::sqrt(std::max(2 * (stored + string.shift), std::abs(stored) + string.shift));
        const double per = size > 0.0 ? 1 / size : 0.0;
        string.per_mean = per * string.tension[0];
        Sums sums;
        for (std::size_t q = 0; q < string.parts.size(); ++q) {
            Part& part = *string.parts[q];
            if (q == transverse(string)) {
                for (std::size_t k = 0; k < part.force.size(); k += S::width)
                    S::store(part.direction.data() + k, S::load(part.force.data() + k) * -per);
            } else {
                gradient(string, q);
                for (std::size_t k = 0; k < part.direction.size(); k += S::width)
                    S::store(part.direction.data() + k,
                             S::load(part.direction.data() + k) * S::load(part.scale.data() + k) * per);
            }
            add_direction(part, sums);
        }
        finish_direction(s, sums);
    }

    // The transverse gradient in `direction`, per coordinate.
    void gradient(String& string, std::size_t q) const {
        const auto& g = string.given.parts[q];
        Part& part = *string.parts[q];
        auto& slope = string.slopes[q];
        std::fill(part.direction.begin(), part.direction.end(), 0.0);
        const int order = string.given.order;
        for (std::size_t i = 0; i < slope[2].size(); ++i) slope[2][i] = 0.5 * (slope[0][i] + slope[1][i]);
        const double* const c = slope[2].data() + order;
        for (int i = 0; i < g.cosines_width; i += S::width) {
            V sum = S::load(c + i) * string.tension[0];
            for (int n = 1; n <= order; ++n) sum += (S::load(c + i - n) + S::load(c + i + n)) * string.tension[n];
            S::store(string.on_cosines.data() + i, sum);
        }
        add_product(g.back.data(), g.width, string.on_cosines.data(), g.cosines, part.direction.data());
    }

    static double weight(const String& s, int n) { return s.given.scale * (n == 0 ? 1.0 : 0.5); }

    // Adds `share` of the s_n of each of these coordinates of a transverse part.
    void add_squares(String& string, std::size_t q, double share, const Array<double>& first,
                     const Array<double>& second) const {
        const auto& g = string.given.parts[q];
        const int order = string.given.order;
        double *const c[2] = {string.slopes[q][0].data() + order, string.slopes[q][1].data() + order};
        spread(g, first.data(), second.data(), c[0], c[1]);
        for (double* const from : c) {
            for (int i = 1; i < g.cosines; ++i) from[i] *= 0.5;
            for (int i = 1; i <= order; ++i) from[-i] = from[i];
        }
        for (int n = 0; n <= order; ++n) {
            V sum{};
            for (int i = 0; i < g.cosines_width; i += S::width)
                for (const double* const from : c)
                    sum += S::load(from + i) * (S::load(from + i - n) + S::load(from + i + n));
            double all = S::sum(sum);
            // the first cosine alone is not halved, and half of it was taken
            for (const double* const from : c) all -= from[0] * from[n];
            string.squares[n] += share * (n == 0 ? 0.5 * all : all);
        }
    }

    // Cosines of the slope of two sets of coordinates, in one pass over the matrix.
    static void spread(const Stretch::Part& g, const double* first, const double* second, double* a, double* b) {
        constexpr int many = 4;
        for (int i = 0; i < g.cosines_width; i += many * S::width) {
            V x[many] = {}, y[many] = {};
            const int vectors = std::min(many, (g.cosines_width - i) / S::width);
            const double* at = g.slopes.data() + i;
            const auto sum = [&]<int N>() {
                for (int k = 0; k < g.n; ++k, at += g.cosines_width)
                    for (int j = 0; j < N; ++j) {
                        const V slope = S::load(at + j * S::width);
                        x[j] += slope * first[k], y[j] += slope * second[k];
                    }
            };
            switch (vectors) {
                case 1: sum.template operator()<1>(); break;
                case 2: sum.template operator()<2>(); break;
                case 3: sum.template operator()<3>(); break;
                default: sum.template operator()<many>();
            }
            for (int j = 0; j < vectors; ++j)
                S::store(a + i + j * S::width, x[j]), S::store(b + i + j * S::width, y[j]);
        }
    }

    // U, in the state of the run.
    double potential(int s) {
        String& string = at(s);
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        for (std::size_t q = 0; q < string.parts.size(); ++q) {
            Part& part = *string.parts[q];
            const auto& g = string.given.parts[q];
            read(part);
            if (q < transverse(string)) add_squares(string, q, 0.5, part.here, part.here);
            else add_product(g.slopes.data(), g.cosines_width, part.here.data(), g.n, string.strain.data());
        }
        double sum = 0.0;
        for (int n = 0; n <= string.given.order; ++n)
            sum += weight(string, n) * string.squares[n] * (0.5 * string.squares[n] + string.strain[n]);
        return sum;
    }

    // C for the next steps: all energy of the string, or the shortfall of U if that is more, and a little.
    double shift(int s, double stored) const {
        double modes = 0.0;
        for (const Part* part : at(s).parts) modes += energy(*part);
        return std::max({modes + stored, -stored, 0.0}) + kLeastShift * at(s).given.scale;
    }

    std::vector<String> strings_;
};

}  // namespace
}  // namespace tonewood
