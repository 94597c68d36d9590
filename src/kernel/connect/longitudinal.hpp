// Strings with longitudinal motion, and strings without it beside them: their direction is the gradient of U; the
// equations are in tonewood.physics.coupling.geometric.
#pragma once

#include "../modal/stretch_pass.hpp"
#include "rising.hpp"

namespace tonewood {
namespace {

constexpr double kLeastShift = 1e-8;  // part of EA L by which C exceeds the energy of a string

class StretchedStrings final : public RisingTensions {
public:
    explicit StretchedStrings(Block& block) : RisingTensions(block), pulled_(t_.width), answered_(t_.width) {
        for (int s = 0; s < n_strings(); ++s) {
            String string{t_.stretches[s]};
            for (std::size_t q = 0; q < string.given.parts.size(); ++q) {
                const auto& g = string.given.parts[q];
                Part part{g, states_[t_.strings[s].first_part + int(q)]};
                const std::size_t n = (g.n + kPadding - 1) / kPadding * kPadding;
                for (Array<double>* a : {&part.here, &part.free, &part.force, &part.direction}) a->assign(n, 0.0);
                for (Array<double>& a : part.slope) a.assign(g.cosines_width + 2 * string.given.order + kLane, 0.0);
                part.on_cosines.assign(g.cosines_width, 0.0);
                string.parts.push_back(std::move(part));
            }
            const std::size_t order = padded(string.given.order + 1);
            for (Array<double>* a : {&string.squares, &string.strain, &string.tension, &string.stretching})
                a->assign(order, 0.0);
            strings_.push_back(std::move(string));
            const double* const kept = row(s);
            const double stored = potential(s) + kept[3];
            strings_[s].shift = std::abs(kept[1]);
            if (!(strings_[s].shift > 0.0 && stored + strings_[s].shift > 0.0)) strings_[s].shift = shift(s, stored);
            ws_.psi[s] = std::copysign(std::sqrt(2 * (stored + strings_[s].shift)), kept[1]);
            ws_.past[0][s] = kept[0];
        }
    }

    double excursion(int) const override { return 0.0; }               // contacts on these strings are never culled,
    ContactSums contact(int, int) const override { return {0, 0, 0}; }  // and have fixed ports

protected:
    void sum(const Polarization& part, double* to) override { sum_stretch_step(*part.c, part.state, to); }
    void make(const Polarization& p) override {
        const Tensions::Part& at = *p.part;
        const int within = int(&at - t_.parts.data()) - t_.strings[at.string].first_part;
        const Array<double>& modal = strings_[at.string].parts[std::size_t(within)].force;
        make_stretch_step(*p.c, p.state, ws_.forces.data() + at.first_port, modal.data(), modal.size());
    }

    void direct() override {
        std::fill(pulled_.begin(), pulled_.end(), 0.0);
        for (int s = 0; s < n_strings(); ++s) stretch(s);
        // the connections answer to the longitudinal modes under s_n
        std::copy(ws_.driven.begin(), ws_.driven.end(), answered_.begin());
        add_product(t_.onto_ports.data(), t_.width, pulled_.data(), int(t_.ports.size()), answered_.data());
        for (int s = 0; s < n_strings(); ++s) strain(s), direct(s);
    }

    void end_step() override {
        for (int s = 0; s < n_strings(); ++s) {
            const double mean = ws_.mean[s];
            ws_.psi[s] = 2 * mean - ws_.psi[s];
            ws_.past[0][s] = strings_[s].per_mean * mean;
            for (Part& part : strings_[s].parts)
                for (std::size_t k = 0; k < part.force.size(); k += S::width)
                    S::store(part.force.data() + k, S::load(part.direction.data() + k) * -mean);
        }
    }

    // Puts V back to U where it `resets`, and chooses C anew.
    void keep(int s, bool resets) override {
        String& string = strings_[s];
        double excess = 0.5 * ws_.psi[s] * ws_.psi[s] - string.shift - potential(s);
        if (resets) {
            excess += pay_from_motion(
                [&](const auto& use) {
                    for (const Part& part : string.parts) use(part.given.component, std::size_t(part.given.n));
                },
                -excess);
            const double stored = potential(s) + excess;
            string.shift = shift(s, stored);
            ws_.psi[s] = std::sqrt(2 * (stored + string.shift));
        }
        row(s)[0] = ws_.past[0][s], row(s)[1] = std::copysign(string.shift, ws_.psi[s]), row(s)[2] = 0.0,
        row(s)[3] = excess;
    }

private:
    struct Part {
        const Stretch::Part& given;
        const Polarization& modes;
        Array<double> here{}, free{};        // coordinates before the step, and free of this coupling after it
        Array<double> force{}, direction{};  // modal forces of the last step, and per psi_m; scaled as xi is
        Array<double> slope[3]{};            // cosines of `here`, `free` and their mean; halved but for the first, even
        Array<double> on_cosines{};
    };
    struct String {
        const Stretch& given;
        std::vector<Part> parts{};  // the longitudinal one last
        double shift = 0, per_mean = 0;                            // C; mean tension per psi_m
        Array<double> squares{}, strain{}, tension{}, stretching{};  // s_n, l_n, forces on e_n and on l_n
    };

    static std::size_t transverse(const String& s) { return s.parts.size() - std::size_t(s.given.longitudinal); }

    // Coordinates of a part now and after a step under forces on its ports.
    void coordinates(Part& part, const double* forces) {
        const Component& c = *part.modes.c;
        const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
        const double *numbers = c.tension.numbers.data(), *state = part.modes.state;
        for (std::size_t k = 0; k < part.here.size(); k += kPadding, numbers += step, state += kScaledState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V xi = S::load(state + j), per = S::load(part.given.scale.data() + k + j);
                V free = xi + S::load(state + kPadding + j);
                for (int p = 0; p < c.n_ports; ++p)
                    free += S::load(numbers + (kScaledNumbers + p) * kPadding + j) * forces[p];
                S::store(part.here.data() + k + j, per * xi), S::store(part.free.data() + k + j, per * free);
            }
    }
    // Displacements of a part's ports by modal forces: use(port, displacement).
    template <class Use>
    void ports(const Part& part, const double* modal, const Use& use) const {
        const Component& c = *part.modes.c;
        const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
        for (int p = 0; p < c.n_ports; ++p) {
            const double* numbers = c.tension.numbers.data() + (kScaledNumbers + p) * kPadding;
            V sum{};
            for (std::size_t k = 0; k < part.here.size(); k += kPadding, numbers += step)
                for (int j = 0; j < kPadding; j += S::width) sum += S::load(numbers + j) * S::load(modal + k + j);
            use(part.modes.part->first_port + p, S::sum(sum));
        }
    }

    // s_n of the step, and the displacements of the ports by the longitudinal modes under it.
    void stretch(int s) {
        String& string = strings_[s];
        const int order = string.given.order;
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        for (std::size_t q = 0; q < transverse(string); ++q) {
            Part& part = string.parts[q];
            coordinates(part, ws_.driven.data() + part.modes.part->first_port);
            add_squares(string, part, 0.5, part.here, part.free);
        }
        for (int n = 0; n <= order; ++n) string.stretching[n] = weight(string, n) * string.squares[n];
        if (!string.given.longitudinal) return;
        Part& part = string.parts.back();
        const auto& g = part.given;
        std::fill(part.force.begin(), part.force.end(), 0.0);
        add_product(g.back.data(), g.width, string.stretching.data(), order + 1, part.force.data());
        for (std::size_t k = 0; k < part.force.size(); k += S::width)
            S::store(part.force.data() + k, S::load(part.force.data() + k) * S::load(g.scale.data() + k) * -1.0);
        ports(part, part.force.data(), [&](int port, double moved) { pulled_[port] = moved; });
    }

    // l_n: the mean strain over the step.
    void strain(int s) {
        String& string = strings_[s];
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        if (!string.given.longitudinal) return;
        Part& part = string.parts.back();
        const auto& g = part.given;
        coordinates(part, answered_.data() + part.modes.part->first_port);
        for (std::size_t k = 0; k < part.here.size(); k += S::width)
            S::store(part.free.data() + k, (S::load(part.here.data() + k) + S::load(part.free.data() + k) +
                                            S::load(part.force.data() + k) * S::load(g.scale.data() + k)) * 0.5);
        add_product(g.slopes.data(), g.cosines_width, part.free.data(), g.n, string.strain.data());
    }

    void direct(int s) {
        String& string = strings_[s];
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
        double power = 0.0, own = 0.0, answered = 0.0;
        for (std::size_t q = 0; q < string.parts.size(); ++q) {
            Part& part = string.parts[q];
            const auto& g = part.given;
            if (q == transverse(string)) {
                for (std::size_t k = 0; k < part.force.size(); k += S::width)
                    S::store(part.direction.data() + k, S::load(part.force.data() + k) * -per);
            } else {
                gradient(string, part);
                for (std::size_t k = 0; k < part.direction.size(); k += S::width)
                    S::store(part.direction.data() + k,
                             S::load(part.direction.data() + k) * S::load(g.scale.data() + k) * per);
            }
            V along{}, size_{};
            const double* state = part.modes.state + kPadding;
            for (std::size_t k = 0; k < part.direction.size(); k += kPadding, state += kScaledState * kPadding)
                for (int j = 0; j < kPadding; j += S::width) {
                    const V d = S::load(part.direction.data() + k + j);
                    along += d * S::load(state + j), size_ += d * d;
                }
            power += S::sum(along), own += S::sum(size_);
            ports(part, part.direction.data(), [&](int port, double moved) {
                ws_.reach[port] = moved, answered += ws_.answering[port] * moved;
            });
        }
        own_[s] = own;
        ws_.alone[s] = ws_.psi[s] + 0.5 * (power + answered);
    }

    // The transverse gradient in `direction`, per coordinate.
    void gradient(const String& string, Part& part) const {
        const auto& g = part.given;
        std::fill(part.direction.begin(), part.direction.end(), 0.0);
        if (!string.given.longitudinal) {
            for (std::size_t k = 0; k < part.direction.size(); k += S::width)
                S::store(part.direction.data() + k, (S::load(part.here.data() + k) + S::load(part.free.data() + k)) *
                                                    S::load(g.stretch.data() + k) * (0.5 * string.tension[0]));
            return;
        }
        const int order = string.given.order;
        for (std::size_t i = 0; i < part.slope[2].size(); ++i)
            part.slope[2][i] = 0.5 * (part.slope[0][i] + part.slope[1][i]);
        const double* const c = part.slope[2].data() + order;
        for (int i = 0; i < g.cosines_width; i += S::width) {
            V sum = S::load(c + i) * string.tension[0];
            for (int n = 1; n <= order; ++n) sum += (S::load(c + i - n) + S::load(c + i + n)) * string.tension[n];
            S::store(part.on_cosines.data() + i, sum);
        }
        add_product(g.back.data(), g.width, part.on_cosines.data(), g.cosines, part.direction.data());
    }

    static double weight(const String& s, int n) { return s.given.scale * (n == 0 ? 1.0 : 0.5); }

    // Adds `share` of the s_n of each of these coordinates of a transverse part.
    void add_squares(String& string, Part& part, double share, const Array<double>& first,
                     const Array<double>& second) const {
        const auto& g = part.given;
        if (!string.given.longitudinal) {
            V sum{};
            for (std::size_t k = 0; k < first.size(); k += S::width) {
                const V a = S::load(first.data() + k), b = S::load(second.data() + k);
                sum += S::load(g.stretch.data() + k) * (a * a + b * b);
            }
            string.squares[0] += 0.5 * share * S::sum(sum);
            return;
        }
        const int order = string.given.order;
        double *const c[2] = {part.slope[0].data() + order, part.slope[1].data() + order};
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
        String& string = strings_[s];
        std::fill(string.squares.begin(), string.squares.end(), 0.0);
        std::fill(string.strain.begin(), string.strain.end(), 0.0);
        for (std::size_t q = 0; q < string.parts.size(); ++q) {
            Part& part = string.parts[q];
            const double* const x = block_.x(part.given.component);
            const auto& reading = part.modes.c->tension.reading;
            for (int k = 0; k < part.given.n; ++k) part.here[k] = reading[k] * x[k];
            if (q < transverse(string)) add_squares(string, part, 0.5, part.here, part.here);
            else
                add_product(part.given.slopes.data(), part.given.cosines_width, part.here.data(), part.given.n,
                            string.strain.data());
        }
        double sum = 0.0;
        for (int n = 0; n <= string.given.order; ++n)
            sum += weight(string, n) * string.squares[n] * (0.5 * string.squares[n] + string.strain[n]);
        return sum;
    }

    // C for the next steps: all energy of the string, or the shortfall of U if that is more, and a little.
    double shift(int s, double stored) const {
        double modes = 0.0;
        for (const Part& part : strings_[s].parts) {
            const Component& c = *part.modes.c;
            const double *const per = c.tension.velocity.data(), *const x = block_.x(part.given.component),
                         *const y = block_.y(part.given.component);
            for (int k = 0; k < part.given.n; ++k) {
                const double v = per[k] * x[k] + per[c.n + k] * y[k], displaced = c.tension.reading[k] * x[k];
                modes += 0.5 * (v * v + part.given.stiffness[k] * displaced * displaced);
            }
        }
        return std::max({modes + stored, -stored, 0.0}) + kLeastShift * strings_[s].given.scale;
    }

    std::vector<String> strings_;
    // (ports): displacements by the longitudinal modes, forces with the answer to them
    Array<double> pulled_, answered_;
};

}  // namespace
}  // namespace tonewood
