// Potentials of plugins: C functions of the coordinates; the equations are in tonewood.coupling.potentials.user.
#pragma once

#include "modal_forces.hpp"

namespace tonewood {
namespace {

class UserPotentials final : public ModalForces {
public:
    UserPotentials(PotentialRun& run, int first, int end) : ModalForces(run, first, end) {
        for (int s = first_; s < end_; ++s) {
            const UserPotential& given = t_.users[t_.two_way[s].data];
            One one{given};
            for (std::size_t q = 0; q < given.sizes.size(); ++q) one.parts.push_back(&add_part(s, q, given.sizes[q]));
            one.y.assign(padded(std::size_t(given.n())), 0.0), one.gradient = one.y;
            one.scratch.assign(given.scratch + 1, 0.0);
            potentials_.push_back(std::move(one));
            const double stored = energy_of(at(s)) + row(s)[0];
            const double psi = std::sqrt(2 * std::max(stored + given.shift, 0.0));
            ws_.psi[s] = row(s)[1] < 0.0 ? -psi : psi;
        }
    }

    void direct() override {
        for (int s = first_; s < end_; ++s) {
            One& one = at(s);
            double* y = one.y.data();
            for (Part* part : one.parts) {
                middle(*part, ws_.driven.data() + part->modes.part->first_port);
                y = std::copy_n(part->free.data(), part->n, y);
            }
            const double value = one.given.call(one.y.data(), one.gradient.data(), one.scratch.data());
            const double size = std::sqrt(2 * std::max(value + one.given.shift, 0.0));
            const double per = size > 0.0 ? 1 / size : 0.0;
            const double* gradient = one.gradient.data();
            Sums sums;
            for (Part* part : one.parts) {
                const Coordinates& c = part->modes.c->coordinates;
                for (int k = 0; k < part->n; ++k)
                    part->direction[k] = per > 0.0 ? *gradient++ * c.impulse[k] * part->scale[k] * per : 0.0;
                add_direction(*part, sums);
            }
            finish_direction(s, sums);
        }
    }

    void end_step() override {
        for (int s = first_; s < end_; ++s) make_forces(s, at(s).parts);
    }

    void keep(int s, bool resets) override {
        One& one = at(s);
        const double value = energy_of(one), C = one.given.shift;
        double excess = 0.5 * ws_.psi[s] * ws_.psi[s] - C - value;
        if (resets) {
            excess += pay(one.parts, -excess);
            ws_.psi[s] = std::sqrt(2 * std::max(value + excess + C, 0.0));
        }
        row(s)[0] = excess, row(s)[1] = std::copysign(1.0, ws_.psi[s]);
    }

private:
    struct One {
        const UserPotential& given;
        std::vector<Part*> parts{};
        Array<double> y{}, gradient{}, scratch{};
    };

    One& at(int s) { return potentials_[std::size_t(s - first_)]; }

    // Coordinates of a part after half a step under forces on its ports, in `free`.
    static void middle(Part& part, const double* forces) {
        const Component& c = *part.modes.c;
        const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding, n = c.n;
        const double *numbers = c.coordinates.numbers.data(), *state = part.modes.state;
        const double* const m = c.coordinates.middle.data();
        for (std::size_t k = 0; k < part.free.size(); k += kPadding, numbers += step, state += kScaledState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V xi = S::load(state + j), free = xi + S::load(state + kPadding + j);
                V by_ports{};
                for (int p = 0; p < c.n_ports; ++p)
                    by_ports += S::load(numbers + (kScaledNumbers + p) * kPadding + j) * forces[p];
                const V y = S::load(m + k + j) * xi + S::load(m + n + k + j) * free +
                            S::load(m + 2 * n + k + j) * by_ports;
                S::store(part.free.data() + k + j, S::load(part.scale.data() + k + j) * y);
            }
    }

    // V in the state of the run.
    double energy_of(One& one) {
        double* y = one.y.data();
        for (Part* part : one.parts) {
            read(*part);
            y = std::copy_n(part->here.data(), part->n, y);
        }
        return one.given.call(one.y.data(), nullptr, one.scratch.data());
    }

    std::vector<One> potentials_;
};

}  // namespace
}  // namespace tonewood
