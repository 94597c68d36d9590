// Potentials whose forces on the lowest modes of their components are held as arrays: base of all kinds whose direction
// is no simple multiple of the coordinates.
#pragma once

#include "../modal/stretch_pass.hpp"
#include "solve.hpp"

namespace tonewood {
namespace {

class ModalForces : public PotentialGroup {
protected:
    struct Part {
        const PotentialPart& modes;
        int n;                               // coordinates: the lowest modes
        // (n, padded as modes are): coordinate per xi of modal/scaled_modes.hpp; in the middle of the step per 2 xi + v,
        // and per modal force; (ports, padded n) per force on a port
        Array<double> scale, begun{}, driven{}, by_port{};
        Array<double> middle{};              // coordinates in the middle of the step, and in the state of the run
        Array<double> force{}, direction{};  // modal forces on fast coordinates, and per psi_m; scaled as xi is
    };

    ModalForces(PotentialRun& run, int first, int end) : PotentialGroup(run, first, end), parts_(run.parts.size()) {}

    void end_step() override {
        for (int s = first_; s < end_; ++s) ws_.psi[s] = 2 * ws_.mean[s] - ws_.psi[s];
    }

    void sum(const PotentialPart& part, double* to) override { sum_stretch_step(*part.c, part.state, to); }
    void make(const PotentialPart& part) override { make(part, nullptr); }
    bool advance(const PotentialPart& part, double* to) override {
        if (!part.known) make(part, to);
        return !part.known;
    }

    // Part q of potential s, over its lowest n modes.
    Part& add_part(int s, std::size_t q, int n) {
        const std::size_t index = std::size_t(t_.two_way[s].first_part) + q, wide = (n + kPadding - 1) / kPadding * kPadding;
        const PotentialPart& modes = run_.parts[index];
        parts_[index] = std::make_unique<Part>(Part{modes, n, Array<double>(wide, 0.0)});
        Part& part = *parts_[index];
        for (Array<double>* a : {&part.middle, &part.force, &part.direction, &part.begun, &part.driven})
            a->assign(wide, 0.0);
        const Coordinates& c = modes.c->coordinates;
        const std::size_t ports = std::size_t(modes.c->n_ports), step = (kScaledNumbers + ports) * kPadding;
        part.by_port.assign(ports * wide, 0.0);
        for (std::size_t k = 0; k < std::size_t(n); ++k) {
            part.scale[k] = c.reading[k] * std::sqrt(c.gain[k]);
            part.begun[k] = part.scale[k] * c.middle[k];
            part.driven[k] = part.scale[k] * c.middle[std::size_t(modes.c->n) + k];
            const double* const rows = c.numbers.data() + k / kPadding * step + kScaledNumbers * kPadding + k % kPadding;
            for (std::size_t p = 0; p < ports; ++p) part.by_port[p * wide + k] = part.driven[k] * rows[p * kPadding];
        }
        return part;
    }

    // Coordinates of a part in the middle of a step under forces on its ports, and modal forces (scaled as xi is).
    static void find_middle(Part& part, const double* forces, const double* modal = nullptr) {
        const std::size_t wide = part.middle.size();
        const double *state = part.modes.state, *const known = part.modes.known;
        const int n_ports = part.modes.c->n_ports;
        for (std::size_t k = 0; k < wide; k += kPadding, state += kScaledState * kPadding)
            for (std::size_t i = k; i < k + kPadding; i += S::width) {
                const V xi = S::load(state + i - k);
                V y = S::load(part.begun.data() + i) * (xi + xi + S::load(state + kPadding + i - k));
                for (int p = 0; p < n_ports; ++p) y += S::load(part.by_port.data() + p * wide + i) * forces[p];
                if (modal) y += S::load(part.driven.data() + i) * S::load(modal + i);
                if (known) y += S::load(part.scale.data() + i) * S::load(known + i) * 0.5;
                S::store(part.middle.data() + i, y);
            }
    }

    // Displacements of a part's ports by modal forces: use(port, displacement).
    template <class Use>
    static void ports(const Part& part, const double* modal, const Use& use) {
        const Component& c = *part.modes.c;
        const std::size_t step = std::size_t(kScaledNumbers + c.n_ports) * kPadding;
        for (int p = 0; p < c.n_ports; ++p) {
            const double* numbers = c.coordinates.numbers.data() + (kScaledNumbers + p) * kPadding;
            V sum{};
            for (std::size_t k = 0; k < part.middle.size(); k += kPadding, numbers += step)
                for (int j = 0; j < kPadding; j += S::width) sum += S::load(numbers + j) * S::load(modal + k + j);
            use(part.modes.part->first_port + p, S::sum(sum));
        }
    }

    // Sums of a potential's directions.
    struct Sums {
        double power = 0, own = 0, answered = 0;
    };
    // Adds those of a part whose direction is known, and writes the displacements of its ports per psi_m.
    void add_direction(const Part& part, Sums& sums) {
        V along{}, size{};
        const double* state = part.modes.state + kPadding;
        for (std::size_t k = 0; k < part.direction.size(); k += kPadding, state += kScaledState * kPadding)
            for (int j = 0; j < kPadding; j += S::width) {
                const V d = S::load(part.direction.data() + k + j);
                along += d * S::load(state + j), size += d * d;
            }
        sums.power += S::sum(along), sums.own += S::sum(size);
        ports(part, part.direction.data(), [&](int port, double moved) {
            ws_.reach[port] = moved, sums.answered += ws_.answering[port] * moved;
        });
    }
    void finish_direction(int s, const Sums& sums) {
        ws_.own[s] = sums.own;
        ws_.alone[s] = ws_.psi[s] + 0.5 * (sums.power + sums.answered);
    }

    // Coordinates of a part in the state of the run.
    void read(Part& part) const {
        const double* const x = block_.x(part.modes.part->component);
        for (int k = 0; k < part.n; ++k) part.middle[k] = part.modes.c->coordinates.reading[k] * x[k];
    }

    // Energy of a part's modes in the state of the run.
    double energy_of(const Part& part) const {
        const Component& c = *part.modes.c;
        const int i = part.modes.part->component;
        const double *const per = c.coordinates.velocity.data(), *const x = block_.x(i), *const y = block_.y(i);
        double sum = 0.0;
        for (int k = 0; k < part.n; ++k) {
            const double v = per[k] * x[k] + per[c.n + k] * y[k], displaced = c.coordinates.reading[k] * x[k];
            sum += 0.5 * (v * v + c.coordinates.stiffness[k] * displaced * displaced);
        }
        return sum;
    }

    double pay_of(const std::vector<Part*>& parts, double cost) {
        return pay_from_motion(
            [&](const auto& use) {
                for (const Part* part : parts) use(part->modes.part->component, std::size_t(part->n));
            },
            cost);
    }

private:
    // `to`: of the sums of the next step; null for none.
    void make(const PotentialPart& p, double* to) {
        const Array<double>& direction = parts_[std::size_t(&p - run_.parts.data())]->direction;
        make_stretch_step(*p.c, p.state, ws_.forces.data() + p.part->first_port, direction.data(), direction.size(),
                          -ws_.mean[p.part->potential], to);
    }

    std::vector<std::unique_ptr<Part>> parts_;  // as those of the run; none of other kinds
};

}  // namespace
}  // namespace tonewood
