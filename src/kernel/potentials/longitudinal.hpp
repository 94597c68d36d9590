// Strings with longitudinal motion: their direction is the gradient of U; the equations are in
// tonewood.physics.coupling.potentials.longitudinal.
//
// The slopes are evaluated at points: half their squares, summed with cosines, are the s_n, and the tension that s_n
// and l_n make pulls them there. One matrix, from modes to slopes at the points, serves both ways and all polarizations with
// the same shapes.
#pragma once

#include "modal_forces.hpp"
#include "plane_products.hpp"

namespace tonewood {
namespace {

constexpr double kLeastShift = 1e-8;  // part of EA L by which C exceeds the energy of a string

class StretchedStrings final : public ModalForces {
public:
    StretchedStrings(PotentialRun& run, int first, int end) : ModalForces(run, first, end) {
        for (int s = first_; s < end_; ++s) {
            String string{t_.stretches[t_.two_way[s].data]};
            const Stretch& g = string.given;
            for (std::size_t q = 0; q < g.sizes.size(); ++q) {
                string.parts.push_back(&add_part(s, q, g.sizes[q]));
                string.slopes.emplace_back(g.width_at_points, 0.0);
            }
            for (Array<double>* a : {&string.squares, &string.strain, &string.tension, &string.stretching})
                a->assign(g.strain_width, 0.0);
            string.at_points.assign(g.width_at_points, 0.0);
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

    double energy(int s) override {
        String& string = at(s);
        for (Part* part : string.parts) read(*part);
        find_squares(string);
        find_strain(string);
        return stored(string);
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
        std::vector<Part*> parts{};           // the longitudinal one last
        std::vector<Array<double>> slopes{};  // by part: slopes of the middle at the points, later the forces on them
        Array<double> squares{}, strain{}, tension{}, stretching{};  // s_n, l_n, their sum, forces on l_n
        Array<double> at_points{};            // sums of squared slopes, later tensions
    };

    // U of s_n and l_n; s_n + l_n in `tension`.
    static double stored(String& string) {
        const Stretch& g = string.given;
        V sum{};
        for (int n = 0; n < g.strain_width; n += S::width) {
            const V square = S::load(string.squares.data() + n), strain = S::load(string.strain.data() + n);
            sum += S::load(g.weights.data() + n) * square * (square * 0.5 + strain);
            S::store(string.tension.data() + n, square + strain);
        }
        return S::sum(sum);
    }

    String& at(int s) { return strings_[std::size_t(s - first_)]; }

    // s_n of the step, and the displacements of the ports by the longitudinal modes under it.
    void stretch(int s) {
        String& string = at(s);
        const Stretch& g = string.given;
        for (std::size_t q = 0; q + 1 < string.parts.size(); ++q)
            find_middle(*string.parts[q], ws_.driven.data() + string.parts[q]->modes.part->first_port);
        find_squares(string);
        for (int n = 0; n < g.strain_width; n += S::width)
            S::store(string.stretching.data() + n, S::load(g.weights.data() + n) * S::load(string.squares.data() + n));
        Part& part = *string.parts.back();
        std::fill(part.force.begin(), part.force.end(), 0.0);
        add_product(g.back.data(), g.width, string.stretching.data(), g.order + 1, part.force.data());
        for (std::size_t k = 0; k < part.force.size(); k += S::width)
            S::store(part.force.data() + k, S::load(part.force.data() + k) * S::load(part.scale.data() + k) * -1.0);
        ports(part, part.force.data(), [&](int port, double moved) { ws_.pulled[port] = moved; });
    }

    // l_n of the coordinates in `middle`.
    static void find_strain(String& string) {
        const Stretch& g = string.given;
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        add_product(g.strain.data(), g.strain_width, string.parts.back()->middle.data(), g.sizes.back(),
                    string.strain.data());
    }

    // l_n: the strain in the middle of the step.
    void strain(int s) {
        Part& part = *at(s).parts.back();
        find_middle(part, ws_.answered.data() + part.modes.part->first_port, part.force.data());
        find_strain(at(s));
    }

    void direct(int s) {
        String& string = at(s);
        const double U = stored(string), C = ws_.shift[s], size = std::sqrt(std::max(2 * (U + C), std::abs(U) + C));
        const double per = size > 0.0 ? 1 / size : 0.0;
        find_gradient(string);
        Sums sums;
        for (Part* part : string.parts) {
            const bool transverse = part != string.parts.back();
            const double* const from = transverse ? part->direction.data() : part->force.data();
            for (std::size_t k = 0; k < part->direction.size(); k += S::width)
                S::store(part->direction.data() + k,
                         transverse ? S::load(from + k) * S::load(part->scale.data() + k) * per
                                    : S::load(from + k) * -per);
            add_direction(*part, sums);
        }
        finish_direction(s, sums);
    }

    // use<Planes>(planes, their parts) of polarizations that share their shapes.
    template <class Use>
    static void by_planes(const String& string, const Use& use) {
        for (const Stretch::Planes& planes : string.given.planes) {
            Part* const* const parts = string.parts.data() + planes.first;
            if (planes.count == 2) use.template operator()<2>(planes, parts);
            else use.template operator()<1>(planes, parts);
        }
    }

    // s_n of the coordinates in `middle`: cosines of half the squared slopes.
    static void find_squares(String& string) {
        const Stretch& g = string.given;
        double* const all = string.at_points.data();
        std::fill_n(all, g.width_at_points, 0.0);
        by_planes(string, [&]<int Count>(const Stretch::Planes& planes, Part* const* parts) {
            const double* y[Count];
            double* slopes[Count];
            for (int p = 0; p < Count; ++p)
                y[p] = parts[p]->middle.data(), slopes[p] = string.slopes[planes.first + p].data();
            multiply_planes<Count>(planes.slopes.data(), g.width_at_points, planes.n, y, slopes);
            for (int j = 0; j < g.width_at_points; j += S::width)
                for (int p = 0; p < Count; ++p)
                    S::store(all + j, S::load(all + j) + S::load(slopes[p] + j) * S::load(slopes[p] + j));
        });
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        add_product(g.project.data(), g.strain_width, all, g.points, string.squares.data());
    }

    // The transverse gradient in `direction`, per coordinate: the tension at each point pulls the slope there.
    static void find_gradient(String& string) {
        const Stretch& g = string.given;
        double* const tension = string.at_points.data();
        const double* const parts_of[] = {string.tension.data()};
        double* const to_points[] = {tension};
        multiply_planes<1>(g.spread.data(), g.width_at_points, g.order + 1, parts_of, to_points);
        by_planes(string, [&]<int Count>(const Stretch::Planes& planes, Part* const* parts) {
            const double* forces[Count];
            double* to[Count];
            for (int p = 0; p < Count; ++p) {
                double* const slopes = string.slopes[planes.first + p].data();
                for (int j = 0; j < g.width_at_points; j += S::width)
                    S::store(slopes + j, S::load(slopes + j) * S::load(tension + j));
                forces[p] = slopes, to[p] = parts[p]->direction.data();
            }
            multiply_planes<Count>(planes.pulls.data(), planes.width, g.points, forces, to);
        });
    }

    std::vector<String> strings_;
};

}  // namespace
}  // namespace tonewood
