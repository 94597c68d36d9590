// Potentials of plugins: C functions of the coordinates; the equations are in tonewood.physics.coupling.potentials.user.
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
        }
    }

    double tolerance() const override { return 1e-7; }
    void direct() override {
        for (int s = first_; s < end_; ++s) {
            One& one = at(s);
            double* y = one.y.data();
            for (Part* part : one.parts) {
                find_middle(*part, ws_.driven.data() + part->modes.part->first_port);
                y = std::copy_n(part->middle.data(), part->n, y);
            }
            const double value = one.given.call(one.y.data(), one.gradient.data(), one.scratch.data());
            const double size = std::sqrt(2 * std::max(value + ws_.shift[s], 0.0));
            const double per = size > 0.0 ? 1 / size : 0.0;
            const double* gradient = one.gradient.data();
            Sums sums;
            for (Part* part : one.parts) {
                for (int k = 0; k < part->n; ++k)
                    part->direction[k] = per > 0.0 ? *gradient++ * part->scale[k] * per : 0.0;
                add_direction(*part, sums);
            }
            finish_direction(s, sums);
        }
    }

    double energy(int s) override {
        One& one = at(s);
        double* y = one.y.data();
        for (Part* part : one.parts) {
            read(*part);
            y = std::copy_n(part->middle.data(), part->n, y);
        }
        return one.given.call(one.y.data(), nullptr, one.scratch.data());
    }
    double shift(int s, double, double) override { return at(s).given.shift; }
    double pay(int s, double cost) override { return pay_of(at(s).parts, cost); }

private:
    struct One {
        const UserPotential& given;
        std::vector<Part*> parts{};
        Array<double> y{}, gradient{}, scratch{};
    };

    One& at(int s) { return potentials_[std::size_t(s - first_)]; }

    std::vector<One> potentials_;
};

}  // namespace
}  // namespace tonewood
