// Strings without longitudinal motion: their direction follows from sums of one modal pass (modal/tension_pass.hpp).
#pragma once

#include "solve.hpp"

namespace tonewood {
namespace {

class ModulatedTensions final : public PotentialGroup {
public:
    using PotentialGroup::PotentialGroup;

    double excursion(int i) const override {
        const int s = t_.parts[run_.part_of[i]].potential;
        const double size = std::sqrt(0.5 * std::max(ws_.spread[s], 0.0)) + ws_.bound[s];
        return std::abs(ws_.mean[s]) * t_.two_way[s].root * size * (1 + 1e-9);
    }

    ContactSums contact(int i, int port) const override {
        const PotentialPart& part = run_.parts[run_.part_of[i]];
        const int s = part.part->potential;
        TensionStep begun = now_[s];
        begun.alone = ws_.driven.data() + part.part->first_port, begun.known = part.known;
        ContactSums out = begun.plain() ? contact_sums<true>(*part.c, part.state, port, begun)
                                        : contact_sums<false>(*part.c, part.state, port, begun);
        out.reach *= t_.two_way[s].root;
        return out;
    }

    // The guard: T such that the highest mode's share of g is divided by T max alpha where that is above one.
    void begin_step() override {
        for (int s = first_; s < end_; ++s) {
            const Potentials::One& string = t_.two_way[s];
            const double turns = string.root * std::max(ws_.psi[s], 0.0) * string.highest;
            now_[s].guard = turns > 1.0 ? (1 - 1 / turns) / string.highest : 0.0;
        }
    }
    void sum(const PotentialPart& part, double* to) override {
        TensionStep begun = now_[part.part->potential];
        begun.known = part.known;
        sum_tension_step(*part.c, part.state, begun, to);
    }
    void make(const PotentialPart& part) override {
        TensionStep made = then_[part.part->potential];
        made.alone = ws_.driven.data() + part.part->first_port, made.found = ws_.forces.data() + part.part->first_port;
        made.known = part.known;
        make_tension_step(*part.c, part.state, made);
    }

    bool advance(const PotentialPart& part, double* to) override {
        const int s = part.part->potential;
        if (part.known || now_[s].guard != 0.0 || then_[s].guard != 0.0) return false;
        TensionStep made = then_[s];
        made.alone = ws_.driven.data() + part.part->first_port, made.found = ws_.forces.data() + part.part->first_port;
        advance_tension(*part.c, part.state, made, to);
        return true;
    }

    void direct() override {
        for (int s = first_; s < end_; ++s) direct(s);
    }

    void end_step() override {
        for (int s = first_; s < end_; ++s) {
            now_[s].tension = t_.two_way[s].root * ws_.mean[s];
            ws_.psi[s] = 2 * ws_.mean[s] - ws_.psi[s];
        }
        then_ = now_;
    }

    double energy(int s) override {
        const double psi = 0.5 * t_.two_way[s].root * stretch(s);
        return 0.5 * psi * psi;
    }
    double pay(int s, double cost) override {
        return pay_from_motion(
            [&](const auto& use) {
                for (const int i : t_.two_way[s].components) use(i, std::size_t(components_[i].n));
            },
            cost);
    }

private:
    // Finds ws.own and ws.reach of string s along its direction, and the right side of its equation in ws.alone.
    void direct(int s) {
        const Potentials::One& string = t_.two_way[s];
        const double* const f = ws_.driven.data() + string.first;
        const double* const answering = ws_.answering.data() + string.first;
        const double T = now_[s].guard, root = string.root;
        double* const reach = ws_.reach.data() + string.first;
        double power = 0.0, own = 0.0, spread = 0.0, bound = 0.0, answered = 0.0;
        for (int i = string.first_part; i < string.first_part + int(string.components.size()); ++i) {
            const Potentials::Part& part = t_.parts[i];
            const double* sum = ws_.sums.data() + part.sums;
            power += sum[0], own += sum[1];
            // of a plain step without p_0: at most so much
            const bool plain = T == 0.0 && !run_.parts[i].known;
            spread += sum[2] * (plain ? components_[part.component].coordinates.largest_first : 1.0);
            sum += kSharedSums;
            const int first = part.first_port - string.first, end = first + components_[part.component].n_ports;
            for (int p = first; p < end; ++p, sum += kPortSums) {
                double moved = sum[3], crossed = 2 * sum[4];
                for (int q = first; q < end; ++q) {
                    const auto& once = string.once[p * string.n + q];
                    const auto& twice = string.twice[p * string.n + q];
                    moved += f[q] * (once[0] + T * once[1]);
                    crossed += f[q] * (twice[0] + T * (twice[1] + T * twice[2]));
                }
                power += f[p] * sum[2], own += f[p] * crossed;
                reach[p] = root * moved, answered += answering[p] * reach[p];
                bound += std::abs(f[p]) * string.steady[p];
            }
        }
        ws_.own[s] = root * root * own;
        ws_.spread[s] = spread, ws_.bound[s] = bound;
        ws_.alone[s] = ws_.psi[s] + 0.5 * (root * power + answered);
    }

    // S of a string in the state of the run.
    double stretch(int s) const {
        double sum = 0.0;
        for (const int i : t_.two_way[s].components) {
            const Component& c = components_[i];
            for (int k = 0; k < c.n; ++k) {
                const double y = c.coordinates.reading[k] * block_.x(i)[k];
                sum += c.coordinates.a[k] * y * y;
            }
        }
        return sum;
    }

    std::vector<TensionStep> now_ = std::vector<TensionStep>(t_.two_way.size()), then_ = now_;  // by string
};

}  // namespace
}  // namespace tonewood
