// Strings with longitudinal motion: their direction is the gradient of U; the equations are in
// tonewood.physics.coupling.potentials.longitudinal.
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
                string.slopes.emplace_back(g.cosines_width + 2 * string.given.order + kLane, 0.0);
            }
            const std::size_t order = padded(string.given.order + 1);
            for (Array<double>* a : {&string.squares, &string.strain, &string.tension, &string.stretching})
                a->assign(order, 0.0);
            std::size_t most = 0;
            for (const auto& g : string.given.parts) most = std::max(most, std::size_t(g.cosines_width));
            string.on_cosines.assign(most, 0.0);
            strings_.push_back(std::move(string));
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
        for (int s = first_; s < end_; ++s) make_forces(s, at(s).parts);
    }

    double energy(int s) override {
        String& string = at(s);
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        for (std::size_t q = 0; q < string.parts.size(); ++q) {
            Part& part = *string.parts[q];
            const auto& g = string.given.parts[q];
            read(part);
            if (q < transverse(string)) add_squares(string, q);
            else add_product(g.slopes.data(), g.cosines_width, part.middle.data(), g.n, string.strain.data());
        }
        double sum = 0.0;
        for (int n = 0; n <= string.given.order; ++n)
            sum += weight(string, n) * string.squares[n] * (0.5 * string.squares[n] + string.strain[n]);
        return sum;
    }

    // All energy of the string, or the shortfall of U if that is more, and a little; held while it is enough.
    double shift(int s, double kept, double stored) override {
        if (kept > 0.0 && stored + kept > 0.0) return kept;
        double modes = 0.0;
        for (const Part* part : at(s).parts) modes += energy_of(*part);
        return std::max({modes + stored, -stored, 0.0}) + kLeastShift * at(s).given.scale;
    }
    double pay(int s, double cost) override { return pay_of(at(s).parts, cost); }

private:
    struct String {
        const Stretch& given;
        std::vector<Part*> parts{};  // the longitudinal one last
        std::vector<Array<double>> slopes{};  // by part: cosines of the middle; halved but for the first, even
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
            find_middle(part, ws_.driven.data() + part.modes.part->first_port);
            add_squares(string, q);
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

    // l_n: the strain in the middle of the step.
    void strain(int s) {
        String& string = at(s);
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        Part& part = *string.parts.back();
        const auto& g = string.given.parts.back();
        find_middle(part, ws_.answered.data() + part.modes.part->first_port, part.force.data());
        add_product(g.slopes.data(), g.cosines_width, part.middle.data(), g.n, string.strain.data());
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
        const double C = ws_.shift[s], size = std::sqrt(std::max(2 * (stored + C), std::abs(stored) + C));
        const double per = size > 0.0 ? 1 / size : 0.0;
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
        std::fill(part.direction.begin(), part.direction.end(), 0.0);
        const int order = string.given.order;
        const double* const c = string.slopes[q].data() + order;
        for (int i = 0; i < g.cosines_width; i += S::width) {
            V sum = S::load(c + i) * string.tension[0];
            for (int n = 1; n <= order; ++n) sum += (S::load(c + i - n) + S::load(c + i + n)) * string.tension[n];
            S::store(string.on_cosines.data() + i, sum);
        }
        add_product(g.back.data(), g.width, string.on_cosines.data(), g.cosines, part.direction.data());
    }

    static double weight(const String& s, int n) { return s.given.scale * (n == 0 ? 1.0 : 0.5); }

    // Adds the s_n of a transverse part.
    void add_squares(String& string, std::size_t q) const {
        const auto& g = string.given.parts[q];
        const int order = string.given.order;
        double* const c = string.slopes[q].data() + order;
        std::fill_n(c, g.cosines_width, 0.0);
        add_product(g.slopes.data(), g.cosines_width, string.parts[q]->middle.data(), g.n, c);
        for (int i = 1; i < g.cosines; ++i) c[i] *= 0.5;
        for (int i = 1; i <= order; ++i) c[-i] = c[i];
        for (int n = 0; n <= order; ++n) {
            V sum{};
            for (int i = 0; i < g.cosines_width; i += S::width)
                sum += S::load(c + i) * (S::load(c + i - n) + S::load(c + i + n));
            // the first cosine alone is not halved, and half of it was taken
            const double all = S::sum(sum) - c[0] * c[n];
            string.squares[n] += n == 0 ? 0.5 * all : all;
        }
    }

    std::vector<String> strings_;
};

}  // namespace
}  // namespace tonewood
